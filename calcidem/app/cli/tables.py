"""What several commands show: Vs against content, and the console for it."""

import math
import os
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from calcidem.analysis.doubt import is_in_doubt
from calcidem.analysis.error_budget import BUDGET_QUANTITIES, budget_text, error_budget
from calcidem.analysis.shear_wave import FEWEST_WAVELENGTHS, small_strain_modulus
from calcidem.app.campaign.status import UNREAD
from calcidem.storage.records import CellStatus
from calcidem.storage.records.error_budget import MOST_DEPARTURE
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection
from calcidem.sweep.environment import TERMINAL_VARIABLE, launcher
from calcidem.sweep.progress import pluralize

PLAIN_WIDTH = 110
"""Columns without a terminal."""


def make_console() -> Console:
    """Console for results.

    A rank cannot see by itself whether a terminal reads it, since launchers give it a pseudo-terminal.
    """
    if launcher() is None and sys.stdout.isatty():
        return Console(highlight=False)
    columns = int(os.environ.get(TERMINAL_VARIABLE, "0"))
    return Console(highlight=False, force_terminal=columns > 0, width=columns or PLAIN_WIDTH)


def format_number(value: float | None, form: str = "{:.1f}", missing: str = "-") -> str:
    """Write a number in a form, or what stands for a missing one (None or not finite)."""
    return missing if value is None or not math.isfinite(value) else form.format(value)


def vs_table(store: Store, selection: Selection) -> Table:
    """Table of Vs against content, of the selected cells of the campaign that is chosen in the store."""
    others = ("content", "status", "wavelengths_on_path", "seconds", "broken_bonds")
    columns = store.table((*BUDGET_QUANTITIES, *others), selection)
    table = Table(title="Shear-wave velocity", title_justify="left", box=SIMPLE_HEAD)
    velocities = ("mean m/s", "sd m/s", "reading m/s", "min m/s", "max m/s")
    for name in ("content %", "done", *velocities, "G0 MPa", "L/lambda", "seconds"):
        table.add_column(name, justify="right")
    table.add_column("other cells")
    marks = []
    for content in np.unique(columns["content"]):
        here = columns["content"] == content
        vs = columns["vs"][here].astype(float)
        budget = error_budget({name: columns[name][here] for name in BUDGET_QUANTITIES})
        marks.append(marks_of(Counter(map(CellStatus, columns["status"][here])), budget.departing))
        seconds = np.nansum(columns["seconds"][here].astype(float))
        moments = _moments(vs[np.isfinite(vs)])
        table.add_row(
            f"{content:g}",
            f"{np.count_nonzero(np.isfinite(vs))}/{np.count_nonzero(here)}{marks[-1]}",
            *map(format_number, (*moments[:2], budget.scatter, *moments[2:])),
            format_number(small_strain_modulus(moments[0]) / 1e6, "{:.4g}"),
            _wavelengths_text(columns["wavelengths_on_path"][here]),
            f"{seconds:.1f}",
            _other_outcomes(columns["status"][here]),
        )
    whole = error_budget(columns)
    remarks = [
        f"standard error of Vs: {budget_text(whole)}; reading m/s: sd that errors of the readings alone would give"
    ]
    if any(str(cell).endswith("*") for column in table.columns for cell in column.cells):
        remarks.append(f"* fewer than {FEWEST_WAVELENGTHS:g} wavelengths between transmitter and receiver: near field")
    remarks += remarks_on(marks, whole.departing)
    if count := int(np.count_nonzero(columns["broken_bonds"] > 0)):
        remarks.append(
            f"the pulse broke bonds in {pluralize(count, 'cell')}: 'calcidem query DB --where \"broken_bonds > 0\"'"
        )
    if any(status in UNREAD for status in columns["status"]):
        remarks.append("'calcidem diagnose DB' explains why cells have no velocity and proposes remedies")
    table.caption, table.caption_justify = "\n".join(remarks), "left"
    return table


def marks_of(counts: Mapping[CellStatus, int], departing: int) -> str:
    """Marks beside the number of cells of a content: where failed ones may bias the mean, or two velocities differ.

    `calcidem.analysis.outcomes` has the first; ``departing`` is the number of cells with the second.
    """
    done = counts.get(CellStatus.DONE, 0)
    failed = sum(counts.values()) - done - counts.get(CellStatus.PENDING, 0) - counts.get(CellStatus.DAMAGED, 0)
    return f"{' !' if is_in_doubt(done, failed) else ''}{' ~' if departing else ''}"


def remarks_on(marks: Iterable[str], departing: int) -> Iterator[str]:
    """What these marks mean, and how to find the cells."""
    if any("!" in mark for mark in marks):
        yield "! possible selection bias: cells without velocity may shift the mean by more than its standard error"
    if departing:
        yield (
            f"~ vs and path_vs differ by more than their errors in {pluralize(departing, 'cell')}: "
            f"'calcidem query DB --where \"path_departure > {MOST_DEPARTURE:g}\"'"
        )


def _wavelengths_text(on_path: NDArray[np.float64]) -> str:
    """Median number of wavelengths on the path, with a mark where near field and shear wave are not apart."""
    known = on_path[np.isfinite(on_path)]
    if not known.size:
        return "-"
    number = float(np.median(known))
    return f"{number:.2f}{'' if number >= FEWEST_WAVELENGTHS else ' *'}"


def _moments(vs: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Mean, standard deviation, smallest and largest; NaN where there are too few."""
    if not vs.size:
        return (np.nan,) * 4
    deviation = float(np.std(vs, ddof=1)) if vs.size > 1 else np.nan
    return float(vs.mean()), deviation, float(vs.min()), float(vs.max())


def _other_outcomes(statuses: NDArray[np.object_]) -> str:
    """How many cells have each outcome other than done."""
    counts = Counter(CellStatus(status) for status in statuses)
    return ", ".join(
        f"{counts[status]} {status.replace('_', ' ')}"
        for status in CellStatus
        if counts[status] and status is not CellStatus.DONE
    )
