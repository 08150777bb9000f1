"""Markdown tables of the studies."""

from collections.abc import Iterable, Sequence


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Table with a line for each row; empty if there are no rows."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *lines]) if lines else ""


def number(value: float | None, form: str = ".1e") -> str:
    """Format a number, or a dash if it is missing."""
    return "-" if value is None else format(value, form)
