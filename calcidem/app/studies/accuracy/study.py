"""Runs a study: the reference of every cell, then the comparison of every setting with it."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calcidem.app.studies.accuracy.reference import COARSEST, CellError, ReferenceCell, find_reference
from calcidem.app.studies.accuracy.settings import Setting, settings
from calcidem.app.studies.cells import ROUNDS, Cells


@dataclass(frozen=True, slots=True)
class Summary:
    """Absolute relative errors of one setting over its cells."""

    setting: str
    numerical: bool
    """See `Setting`."""
    cells: int
    """Compared cells; 0 if the setting was refused."""
    lost: int
    """Cells with a velocity only in the reference."""
    median: float
    worst: float
    """Errors of Vs."""
    arrival: float
    signal: float
    """Medians of the errors of the first arrival and of the whole signal."""
    covered: float
    """Share of cells whose error of Vs is within their stated bound."""
    seconds: float
    """Processor time of a cell."""


@dataclass(frozen=True, slots=True)
class Study:
    """Results of a study."""

    cells: tuple[CellError, ...]
    """Every cell of every setting."""
    summaries: tuple[Summary, ...]
    """One for each setting, over all contents; the experiment's own first."""
    references: tuple[ReferenceCell, ...]
    """One for each cell."""
    reference_seconds: float
    """Processor time of a cell of the reference."""
    seconds: Mapping[str, Mapping[float, float]]
    """Processor time of a cell by setting and content."""

    def cheapest(self, target: float) -> Summary | None:
        """Cheapest numerical setting whose worst relative error of Vs meets a target; None if there is none."""
        meeting = [
            row for row in self.summaries if row.numerical and row.cells and not row.lost and row.worst <= target
        ]
        return min(meeting, key=lambda row: row.seconds, default=None)

    def cheapest_in_words(self, target: float) -> str:
        """Name and cost of the `cheapest`."""
        row = self.cheapest(target)
        return "none of those measured" if row is None else f"{row.setting}, {row.seconds:.2f} s a cell"

    @property
    def pareto(self) -> tuple[Summary, ...]:
        """Settings that no other beats in both median error and run time (Pareto front), fastest first."""
        front: list[Summary] = []
        for row in sorted((s for s in self.summaries if s.numerical and s.cells), key=lambda s: (s.seconds, s.median)):
            if not front or row.median < front[-1].median:
                front.append(row)
        return tuple(front)


def run_study(
    cells: Cells,
    *,
    compared: Iterable[Setting] | None = None,
    coarsest: float = COARSEST,
    rounds: int = ROUNDS,
) -> Study:
    """Measure the errors of settings.

    The experiment's own setting comes first in ``compared``, by default all of `settings.settings`. The search for the
    reference starts at a step of ``coarsest`` times the limit. Settings are timed alternately in ``rounds``.
    """
    compared = tuple(settings(cells.experiment) if compared is None else compared)
    errors: list[CellError] = []
    references: list[ReferenceCell] = []
    reference_seconds: list[float] = []
    seconds: dict[str, dict[float, float]] = defaultdict(dict)
    for content in cells.contents:
        cells.progress(f"{content:g} %: reference")
        exact, exact_cells, taken = find_reference(cells, content, coarsest)
        references += exact_cells
        reference_seconds.append(taken)
        found, times = cells.take_turns({one.name: one.experiment for one in compared}, content, rounds)
        errors += [CellError.compare(name, own[key], exact[key]) for name, own in found.items() for key in exact]
        for name, value in times.items():
            seconds[name][content] = value
    return Study(
        cells=tuple(errors),
        summaries=tuple(
            _summary_of(one, [cell for cell in errors if cell.setting == one.name], seconds.get(one.name, {}))
            for one in compared
        ),
        references=tuple(references),
        reference_seconds=float(np.mean(reference_seconds)),
        seconds=dict(seconds),
    )


def _summary_of(setting: Setting, cells: Sequence[CellError], seconds: Mapping[float, float]) -> Summary:
    """Summary of the cells of one setting; ``seconds`` are processor times of a cell at each content."""
    errors = [abs(cell.vs_error) for cell in cells if cell.vs_error is not None]
    arrivals = [abs(cell.arrival_error) for cell in cells if cell.arrival_error is not None]

    def middle(values: Sequence[float]) -> float:
        return float(np.median(values)) if values else np.inf

    return Summary(
        setting=setting.name,
        numerical=setting.numerical,
        cells=len(errors),
        lost=sum(cell.vs is None and cell.reference_vs is not None for cell in cells),
        median=middle(errors),
        worst=max(errors, default=np.inf),
        arrival=middle(arrivals),
        signal=middle([cell.signal_error for cell in cells]),
        covered=covered_share(cells),
        seconds=float(np.mean(list(seconds.values()))) if seconds else np.inf,
    )


def covered_share(cells: Iterable[CellError]) -> float:
    """Share of the cells with a velocity whose error is within their own bound."""
    honest = [
        abs(cell.vs_error) <= cell.bound for cell in cells if cell.vs_error is not None and cell.bound is not None
    ]
    return float(np.mean(honest)) if honest else np.nan
