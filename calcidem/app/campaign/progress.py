"""Progress of a run: events on rank 0 give snapshots for displays, logs and callers.

The module imports nothing large, since the command that starts the ranks imports it, too.
"""

import json
import time
from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any, Self

from calcidem.dem.sample.packing import PackingStage
from calcidem.sweep.batch import Batch
from calcidem.sweep.outcome import BatchOutcome, Place
from calcidem.sweep.progress import Progress, duration, pluralize
from calcidem.sweep.sweep_end import SweepEnd

_SHORTEST_INTERVAL = 0.2
"""Shortest interval between two snapshots of the same stage, s."""

_LONGEST_TEXT = 3500
"""Largest size of a snapshot in bytes; a larger one is sent without the contents."""


class _Forecast:
    """Counts cells and measures their cost in each group of batches.

    A measured group counts with its own mean seconds for each cell. Others count with their estimated cost, scaled by
    the ratio of measured to estimated cost elsewhere.
    """

    def __init__(self, batches: Iterable[Batch[Any]]) -> None:
        self._cells: Counter[Hashable] = Counter()
        self._remaining: Counter[Hashable] = Counter()
        self._cost: dict[Hashable, float] = defaultdict(float)
        self._seconds: dict[Hashable, float] = defaultdict(float)
        self._measured: Counter[Hashable] = Counter()
        self.extend(batches)

    def extend(self, batches: Iterable[Batch[Any]]) -> None:
        """Count further batches."""
        for batch in batches:
            self._cells[batch.group] += len(batch.cells)
            self._remaining[batch.group] += len(batch.cells)
            self._cost[batch.group] += batch.cost

    @property
    def total(self) -> int:
        """Number of cells of all batches."""
        return self._cells.total()

    def _estimate(self, group: Hashable) -> float:
        """Expected cost of a cell, in the unit of the batches."""
        return self._cost[group] / self._cells[group]

    @property
    def settled(self) -> int:
        """Number of cells that are settled."""
        return self.total - self._remaining.total()

    def record(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Count a final outcome; only results measure the cost of a cell."""
        group, cells = outcome.batch.group, len(outcome.batch.cells)
        self._remaining[group] -= cells
        if outcome.failure is None:
            self._seconds[group] += outcome.seconds
            self._measured[group] += cells

    def seconds_left(self, workers: int) -> float | None:
        """Return the seconds that the remaining cells need on this number of workers, or None if unknown."""
        estimated = sum(self._estimate(group) * cells for group, cells in self._measured.items())
        if self.settled == self.total:
            return 0.0
        if estimated == 0.0 or workers < 1:
            return None
        scale = sum(self._seconds.values()) / estimated
        work = 0.0
        for group, cells in self._remaining.items():
            measured = self._measured[group]
            per_cell = self._seconds[group] / measured if measured else self._estimate(group) * scale
            work += cells * per_cell
        return work / workers


class RunStage(StrEnum):
    """Stage of a run."""

    STARTING = "starting"
    PACKING = "packing"
    COMPILING = "compiling"
    COMPUTING = "computing"
    WRITING = "writing"


@dataclass(frozen=True, slots=True)
class RunProgress:
    """Progress of a run; each snapshot replaces the last.

    Attributes
    ----------
    stage
        Present stage.
    seconds, seconds_left
        Time since the stage began, and until it ends; None if unknown.
    expansion_step, expansion_steps
        Packing: current radius step, from 1, and number of radius steps; one step more while the lid presses.
    time_steps, unbalanced_ratio, target_ratio, fraction
        Packing: time steps so far, unbalanced-force ratio now and at rest, estimated part of the work done.
    kernel, function, functions
        Compilation: kernel, its present function, and number of its finished functions.
    finished, total
        Cells with an outcome, and all cells of this run.
    outcomes
        Numbers of cells by outcome, with the names of `calcidem.storage.records.CellStatus`.
    contents
        (content in percent, finished cells, cells of this run), ascending.
    workers, busy
        Number of workers, and of those that compute.
    """

    stage: RunStage
    seconds: float = 0.0
    seconds_left: float | None = None
    expansion_step: int = 0
    expansion_steps: int = 0
    time_steps: int = 0
    unbalanced_ratio: float | None = None
    target_ratio: float | None = None
    fraction: float = 0.0
    kernel: str = ""
    function: str = ""
    functions: int = 0
    finished: int = 0
    total: int = 0
    outcomes: Mapping[str, int] = field(default_factory=dict)
    contents: tuple[tuple[float, int, int], ...] = ()
    workers: int = 0
    busy: int = 0

    def to_json(self) -> str:
        """Text in one line, short enough for `calcidem.launch.channel`."""
        text = json.dumps(asdict(self))
        return text if len(text) <= _LONGEST_TEXT else replace(self, contents=()).to_json()

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Progress from the text of `to_json`; `ValueError`, `KeyError` or `TypeError` for any other text."""
        values: dict[str, Any] = json.loads(text)
        contents = tuple((content, finished, total) for content, finished, total in values.pop("contents"))
        return cls(RunStage(values.pop("stage")), contents=contents, **values)


class ProgressDisplay:
    """Receives the progress of a run; as a context manager it clears the display on exit. This base shows nothing."""

    def show(self, progress: RunProgress) -> None:
        """Show the progress, replacing the former display."""

    def note(self, text: str) -> None:
        """Write a sentence that remains visible."""

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(self, *exception: object) -> None:
        """End."""


class ProgressReporter(Progress):
    """Sends the progress of a run to a display."""

    def __init__(self, display: ProgressDisplay) -> None:
        self._display = display
        self._last = RunProgress(RunStage.STARTING)
        self._began = time.monotonic()
        self._next = 0.0
        self._forecast = _Forecast([])
        self._contents: dict[float, list[int]] = {}
        self._outcomes: Counter[str] = Counter()

    def begin(self, stage: RunStage) -> None:
        """Report the beginning of a stage without further progress."""
        self._tell(RunProgress(stage))

    def on_packing(self, packing: PackingStage) -> None:
        """Report the progress of the packing."""
        seconds = time.monotonic() - self._began
        self._tell(
            RunProgress(
                RunStage.PACKING,
                seconds_left=seconds * (1.0 / packing.fraction - 1.0) if packing.fraction > 0.0 else None,
                expansion_step=packing.expansion_step,
                expansion_steps=packing.expansion_steps,
                time_steps=packing.steps,
                unbalanced_ratio=packing.unbalanced_ratio,
                target_ratio=packing.target_ratio,
                fraction=packing.fraction,
            )
        )

    def on_compiling(self, kernel: str, function: str, functions: int) -> None:
        """Report the function of a kernel that is compiled, and the number of finished ones."""
        self._tell(RunProgress(RunStage.COMPILING, kernel=kernel, function=function, functions=functions))

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Begin counting cells."""
        self._forecast = _Forecast(batches)
        self._outcomes.clear()
        self._contents = {}
        self._count(batches)
        total = pluralize(self._forecast.total, "cell")
        where = pluralize(workers, "worker") if workers else "the workers of the executor"
        parts = f"{pluralize(len(batches), 'batch', 'batches')} on {where}"
        self._display.note(f"{total} in {parts}" if batches else "Nothing to compute: every cell has an outcome.")
        self._tell_cells(workers, 0)

    def on_further(self, batches: Sequence[Batch[Any]]) -> None:
        """Count further cells."""
        self._forecast.extend(batches)
        self._count(batches)

    def _count(self, batches: Sequence[Batch[Any]]) -> None:
        for batch in batches:
            self._contents.setdefault(batch.cells[0][1], [0, 0])[1] += len(batch.cells)

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Count an outcome, and report a failure."""
        self._forecast.record(outcome)
        self._contents[outcome.batch.cells[0][1]][0] += len(outcome.batch.cells)
        if outcome.failure is None:
            self._outcomes.update(str(result.status) for result in outcome.results or ())
            return
        self._outcomes[str(outcome.failure.kind)] += len(outcome.batch.cells)
        cells, place = ", ".join(f"seed {seed}, {content:g} %" for seed, content in outcome.batch.cells), outcome.place
        self._display.note(
            f"{outcome.failure.kind}: {cells} on rank {place.rank} ({place.host}): {outcome.failure.message}"
        )

    def on_loss(self, place: Place, reason: str) -> None:
        """Report a lost worker."""
        self._display.note(f"lost rank {place.rank} ({place.host}): {reason}")

    def on_heartbeat(self, workers: int, running: int) -> None:
        """Report the progress of the cells."""
        self._tell_cells(workers, running)

    def on_end(self, end: SweepEnd) -> None:
        """Report the end."""
        self._tell_cells(0, 0, at_once=True)
        self._display.note(_end_line(end))

    def _tell_cells(self, workers: int, running: int, *, at_once: bool = False) -> None:
        progress = RunProgress(
            RunStage.COMPUTING,
            seconds_left=self._forecast.seconds_left(workers),
            finished=self._forecast.settled,
            total=self._forecast.total,
            outcomes=dict(sorted(self._outcomes.items(), key=lambda item: (item[0] != "done", item[0]))),
            contents=tuple((content, finished, total) for content, (finished, total) in sorted(self._contents.items())),
            workers=workers,
            busy=running,
        )
        self._tell(progress, at_once=at_once)

    def _tell(self, progress: RunProgress, *, at_once: bool = False) -> None:
        """Send a snapshot to the display, not too often in the same stage."""
        now = time.monotonic()
        if progress.stage is not self._last.stage:
            self._began, at_once = now, True
        if at_once or now >= self._next:
            self._next = now + _SHORTEST_INTERVAL
            self._last = replace(progress, seconds=now - self._began)
            self._display.show(self._last)


def _end_line(end: SweepEnd) -> str:
    """Return one line about the end of a sweep."""
    tally = end.tally
    parts = [
        f"{end.state} after {duration(end.seconds)}",
        f"{tally.settled} cells settled",
        f"{tally.failed} failed" if tally.failed else "",
        f"{tally.timed_out} timed out" if tally.timed_out else "",
        f"{tally.quarantined} quarantined" if tally.quarantined else "",
        f"{pluralize(tally.lost_workers, 'worker')} lost" if tally.lost_workers else "",
        end.detail,
    ]
    return ", ".join(part for part in parts if part)
