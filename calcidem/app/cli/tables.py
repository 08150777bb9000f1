"""Common output of commands: tables, numbers, marks with their meaning, and the console."""

import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from calcidem.analysis.intervals import is_in_doubt
from calcidem.storage.records import CellStatus
from calcidem.storage.records.error_budget import MOST_PULSE_EFFECT
from calcidem.sweep.environment import launcher
from calcidem.sweep.progress import pluralize

PLAIN_WIDTH = 110
"""Number of columns without a terminal."""


def make_console() -> Console:
    """Console for results; launchers give their ranks a pseudo-terminal that nobody sees."""
    if launcher() is None and sys.stdout.isatty():
        return Console(highlight=False)
    return Console(highlight=False, force_terminal=False, width=PLAIN_WIDTH)


def make_table(title: str | None, *names: str, numbers: Sequence[str] = ()) -> Table:
    """Table for people with columns of texts, followed by columns of numbers."""
    table = Table(*names, title=title, title_justify="left", caption_justify="left", box=SIMPLE_HEAD)
    for name in numbers:
        table.add_column(name, justify="right")
    return table


def format_number(value: float | None, form: str = "{:.1f}") -> str:
    """Write a number in a format, or a dash for a missing one (None or not finite)."""
    return "-" if value is None or not math.isfinite(value) else form.format(value)


def marks_of(counts: Mapping[CellStatus, int], loud: int) -> str:
    """Marks beside the number of cells of a content, if failed ones may bias the mean, or the pulse changes them.

    `calcidem.analysis.intervals.is_in_doubt` explains the first; ``loud`` is the number of cells with the second.
    """
    done = counts.get(CellStatus.DONE, 0)
    failed = sum(counts.values()) - done - counts.get(CellStatus.PENDING, 0)
    return f"{' !' if is_in_doubt(done, failed) else ''}{' ~' if loud else ''}"


def remarks_on(marks: Iterable[str], loud: int) -> Iterator[str]:
    """Meaning of these marks, and how to find the cells."""
    if any("!" in mark for mark in marks):
        yield "! possible selection bias: cells without velocity may shift the mean by more than its standard error"
    if loud:
        yield (
            f"~ {pluralize(loud, 'velocity', 'velocities')} depend on the pulse by more than {MOST_PULSE_EFFECT:.0%}: "
            "a smaller wave.amplitude measures the sample"
        )
