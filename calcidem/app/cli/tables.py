"""Common output of commands: tables, numbers, marks with their meaning, and the console."""

import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Column, Table
from rich.text import Text

from calcidem.analysis.intervals import is_in_doubt
from calcidem.ends import CellStatus
from calcidem.storage.records import MOST_PULSE_EFFECT
from calcidem.sweep.ranks import launcher
from calcidem.sweep.schedule import pluralize

PLAIN_WIDTH = 110
"""Number of columns without a terminal."""


def make_console() -> Console:
    """Console for results; launchers give their ranks a pseudo-terminal that nobody sees."""
    if launcher() is None and sys.stdout.isatty():
        return Console(highlight=False)
    return Console(highlight=False, force_terminal=False, width=PLAIN_WIDTH)


class WholeTable(Table):
    """Table that folds into several below each other, each with the first column, rather than cut a number."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render it, or the tables that it folds into."""
        if self.__rich_measure__(console, options.update(max_width=1000)).maximum <= options.max_width:
            yield from super().__rich_console__(console, options)
            return
        first, *others = self.columns
        groups: list[list[Column]] = [[]]
        for column in others:
            if groups[-1] and 1 + sum(map(_least_width, [first, *groups[-1], column])) > options.max_width:
                groups.append([])
            groups[-1].append(column)
        for number, group in enumerate(groups):
            part = Table(box=self.box, title=None if number else self.title, title_justify="left")
            for column in (first, *group):
                width = None if _is_text(column) else _least_width(column) - _BORDER
                part.add_column(column.header, justify=column.justify, width=width, overflow="fold")
            for row in zip(*(column.cells for column in (first, *group)), strict=True):
                part.add_row(*row)
            yield part
        if self.caption is not None:
            yield self.caption


_BORDER = 3
"""Characters of a column's border and padding."""


def _least_width(column: Column) -> int:
    """Characters that a column needs, with its border: whole numbers, the words of a heading or a text each alone."""
    cells = [cell.plain if isinstance(cell, Text) else str(cell) for cell in column.cells]
    texts = [str(column.header), *(cells if _is_text(column) else ())]
    words = [word for text in texts for word in text.split()]
    return max(map(cell_len, words if _is_text(column) else words + cells), default=0) + _BORDER


def _is_text(column: Column) -> bool:
    """Whether lines of a column may break between words."""
    return column.justify == "left" and not column.no_wrap


def make_table(title: str | None, *names: str, numbers: Sequence[str] = ()) -> WholeTable:
    """Table for people with columns of texts, followed by columns of numbers."""
    table = WholeTable(*names, title=title, title_justify="left", caption_justify="left", box=SIMPLE_HEAD)
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
        samples = pluralize(loud, "sample")
        yield (
            f"~ Vs of {samples} depends on the pulse by more than {100 * MOST_PULSE_EFFECT:g} %: "
            "a smaller wave.amplitude measures the sample"
        )
