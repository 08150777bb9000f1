"""Status of a campaign in its database, and the progress of a run on a terminal, in a log or for a function."""

import math
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import compress
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bars
from rich.table import Column
from rich.text import Text

from calcidem.analysis.intervals import Interval
from calcidem.analysis.velocity import (
    BUDGET_QUANTITIES,
    NOTE_QUANTITIES,
    ErrorBudget,
    are_samples,
    error_budget,
    notes_on,
)
from calcidem.ends import CellStatus
from calcidem.storage.errors import StoreError, hide_passwords
from calcidem.storage.records import CellKey, RunRecord, Selection
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.sweep.ranks import launcher
from calcidem.sweep.schedule import Batch, BatchOutcome, Progress, SweepEnd
from calcidem.wording import duration, listening, pluralize, printable, send_nowhere, tell

if TYPE_CHECKING:
    from calcidem.dem.sample.packing import PackingStage  # which readers do not need

STATUS_QUANTITIES = tuple(dict.fromkeys(("seed", "seconds", *BUDGET_QUANTITIES, *NOTE_QUANTITIES)))
"""Quantities of each cell that the status needs."""

_TROUBLES = (
    CellStatus.QUARANTINED, CellStatus.FAILED, CellStatus.TIMED_OUT, CellStatus.UNSTABLE, CellStatus.NO_ARRIVAL,
)  # fmt: skip
"""Outcomes other than done, the most severe first."""

UNREAD = (CellStatus.NO_ARRIVAL, CellStatus.UNSTABLE)
"""Outcomes without a velocity that a new computation would repeat."""

_STATUS_BY_NAME = {status.value: status for status in CellStatus}  # a call of the class takes ten times as long

URGENCY = {status: place for place, status in enumerate((*_TROUBLES, CellStatus.PENDING, CellStatus.DONE))}
"""Rank of each status, the most severe first; pending before done."""


@dataclass(frozen=True, slots=True, eq=False)
class ContentStatus:
    """Progress of the cells of one content."""

    content: float
    """Percent."""
    statuses: Mapping[int, CellStatus]
    """Status by seed."""
    counts: Mapping[CellStatus, int]
    """Number of cells by status."""
    vs: NDArray[np.float64]
    """Velocities of its distinct samples, m/s."""
    mean: float
    deviation: float
    """Mean and standard deviation of these, m/s; NaN with too few."""
    interval: Interval
    """95 % interval of the mean for further seeds of the packing, m/s, by Student's t; without cement by the error."""
    budget: ErrorBudget
    """Errors of its velocities."""
    seconds_per_cell: float
    """Mean computing time of a cell so far; NaN before the first."""
    seconds_left: float
    """Computing time of the pending cells on one core; NaN if none was measured."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """A cell that failed, or that needed several attempts."""

    key: CellKey
    status: CellStatus
    """The cell and its present status."""
    attempts: int
    losses: int
    """Number of attempts, and of those since the last retry during which the run died."""
    reason: str
    """First line of the reason; empty for a done or pending cell."""
    retry: str = ""
    """Reason why its sample was computed again with half the step; else empty."""


@dataclass(frozen=True, slots=True)
class CampaignStatus:
    """Progress of a campaign."""

    name: str
    hash: str
    content_hashes: Mapping[int, str]
    """Content hashes of its packings, by index; None if unknown."""
    seeds: tuple[int, ...]
    contents: tuple[ContentStatus, ...]
    """One for each content, ascending."""
    counts: Mapping[CellStatus, int]
    """Number of cells by status."""
    budget: ErrorBudget
    """Errors of all velocities."""
    notes: tuple[str, ...]
    """Advice, see `calcidem.analysis.velocity.notes_on`."""
    troubles: tuple[Trouble, ...]
    """Cells that failed, were repeated, or needed half the step."""
    last_run: RunRecord | None
    run_number: int | None
    """Latest run, if any."""
    running: bool
    """Whether a process writes the campaign now; one on another machine until its heartbeat is five minutes old."""
    workers: int
    """Number of computing ranks in the latest run."""
    seconds_left: float
    """Time until all cells are settled on this number of workers; NaN if none was measured."""

    @property
    def pending(self) -> int:
        """Number of cells without an outcome."""
        return self.counts.get(CellStatus.PENDING, 0)

    def to_json(self) -> dict[str, Any]:
        """How far it is in JSON's types, without single cells; a number that is not known is None."""
        run = self.last_run
        told = {
            "campaign": self.name,
            "hash": self.hash,
            "running": self.running,
            "run": run
            and {
                "number": self.run_number,
                "host": run.host,
                "ranks": run.ranks,
                "started": f"{run.started:%Y-%m-%d %H:%M} UTC",
                "exit_state": run.exit_state and hide_passwords(run.exit_state),
            },
            "cells": dict(sorted(self.counts.items())),
            "vs_error": self.budget.total,
            "reading_error": self.budget.reading,
            "numerical_error": self.budget.numerical,
            "seconds_left": self.seconds_left,
            "workers": self.workers,
            "notes": self.notes,
            "contents": [
                {
                    "content": one.content,
                    "cells": dict(sorted(one.counts.items())),
                    "mean": one.mean,
                    "sd": one.deviation,
                    "reading_scatter": one.budget.scatter,
                    "loud": one.budget.loud,
                    "interval_95": [one.interval.low, one.interval.high],
                    "seconds_per_cell": one.seconds_per_cell,
                    "core_seconds_left": one.seconds_left,
                }
                for one in self.contents
            ],
        }
        from pydantic_core import to_jsonable_python  # noqa: PLC0415 - tables for people do not need it

        found: dict[str, Any] = to_jsonable_python(told, inf_nan_mode="null")
        return found

    @classmethod
    def of(cls, store: Store, columns: Mapping[str, NDArray[Any]], troubles: tuple[Trouble, ...]) -> Self:
        """Progress of a campaign, in a few short queries, from `STATUS_QUANTITIES` of its planned cells."""
        contents = np.array(sorted(set(columns["content"].tolist())))
        rows = [columns["content"] == content for content in contents]
        seconds = [_mean_or_nan(columns["seconds"][row].astype(float)) for row in rows]
        known = np.isfinite(seconds)  # between these contents, seconds are interpolated
        expected = np.interp(contents, contents[known], np.array(seconds)[known]) if known.any() else seconds
        statuses = tuple(
            _content_status(float(content), {name: values[row] for name, values in columns.items()}, measured, cost)
            for content, row, measured, cost in zip(contents, rows, seconds, expected, strict=True)
        )
        counts: Counter[CellStatus] = Counter()
        for status in statuses:
            counts.update(status.counts)
        runs, holder = store.runs(), store.lease_holder()
        number, last = runs[-1] if runs else (None, None)
        workers = max(1, last.ranks - 1) if last is not None else 1
        return cls(
            name=store.record.name,
            hash=store.record.hash,
            content_hashes=store.content_hashes(),
            seeds=store.record.seeds,
            contents=statuses,
            counts=counts,
            budget=error_budget(columns),
            notes=tuple(notes_on(columns)),
            troubles=troubles,
            last_run=last,
            run_number=number,
            running=holder is not None and holder.may_live(),
            workers=workers,
            seconds_left=sum(status.seconds_left for status in statuses) / workers,
        )

    @classmethod
    def read(cls, database: str | os.PathLike[str], campaign_name: str | None = None) -> Self:
        """Present progress of a stored campaign; `StoreError` if the database is unreadable or lacks the campaign."""
        with read_campaign(database, campaign_name) as store:
            columns = store.table([name for name in STATUS_QUANTITIES if name != "seconds"])
            # Seconds belong to attempts; in a large campaign those of some seeds suffice for a mean at each content.
            columns["seconds"] = np.full(len(columns["seed"]), np.nan)
            seeds = np.unique(columns["seed"][columns["status"] != CellStatus.PENDING.value])
            chosen = seeds[:: max(1, math.ceil(len(columns["seed"]) / 20_000))]
            found = store.table(("seconds",), Selection(chosen.tolist()))["seconds"]
            places = np.isin(columns["seed"], chosen)
            if np.count_nonzero(places) == len(found):  # otherwise cells were planned meanwhile
                columns["seconds"][places] = found
            return cls.of(store, columns, _troubles_of(store, columns))


def _content_status(
    content: float, columns: Mapping[str, NDArray[Any]], measured: float, expected: float
) -> ContentStatus:
    """Progress of one content, from the columns of its cells and the measured and expected seconds of a cell."""
    names = columns["status"].tolist()
    found = dict(zip(columns["seed"].astype(int).tolist(), map(_STATUS_BY_NAME.__getitem__, names), strict=True))
    counts = Counter(found.values())
    counted = are_samples(columns["vs"], content)
    vs = columns["vs"][counted].astype(float)
    is_one = content == 0.0  # without cement all seeds are the same sample
    pending = counts[CellStatus.PENDING]
    return ContentStatus(
        content=content,
        statuses=found,
        counts=counts,
        vs=vs,
        mean=_mean_or_nan(vs),
        deviation=float(np.std(vs, ddof=1)) if vs.size > 1 else np.nan,
        interval=Interval.of_velocity(vs[0], columns["vs_error"][counted][0])
        if is_one and vs.size
        else Interval.of_mean(vs),
        budget=error_budget(columns),
        seconds_per_cell=measured,
        seconds_left=(1 if is_one else pending) * expected if pending else 0.0,
    )


def _mean_or_nan(values: NDArray[np.float64]) -> float:
    """Mean of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else np.nan


def _troubles_of(store: Store, columns: Mapping[str, NDArray[Any]]) -> tuple[Trouble, ...]:
    """Failed cells, the most severe first, then repeated ones."""
    names = columns["status"].tolist()

    def statuses_where(condition: Iterable[object]) -> dict[CellKey, CellStatus]:
        places = list(compress(range(len(names)), condition))
        keys = map(CellKey, columns["seed"][places].tolist(), columns["content"][places].tolist())
        return {key: CellStatus(names[place]) for key, place in zip(keys, places, strict=True)}

    statuses = statuses_where(name in _TROUBLES for name in names)

    def texts(quantity: str, selection: Selection) -> dict[CellKey, str]:
        found = store.table(("seed", "content", quantity), selection)
        keys = map(CellKey, found["seed"].tolist(), found["content"].tolist())
        return {key: str(text or "").partition("\n")[0] for key, text in zip(keys, found[quantity], strict=True)}

    reasons = texts("reason", Selection(statuses=_TROUBLES))
    retries = texts("retry", Selection(where="retry is not None"))
    attempts = store.attempt_counts()
    attempts |= store.attempt_counts((statuses.keys() | retries.keys()) - attempts.keys())
    if others := {(key.seed, key.content) for key in attempts.keys() - statuses.keys()}:
        cells = zip(columns["seed"].tolist(), columns["content"].tolist(), strict=True)
        statuses |= statuses_where(cell in others for cell in cells)
    found = [
        Trouble(
            key,
            statuses[key],
            count.attempts,
            count.losses,
            reasons.get(key) or ("its attempt is missing" if statuses[key] in _TROUBLES else ""),
            retries.get(key, ""),
        )
        for key, count in attempts.items()
        if key in statuses  # otherwise it was planned meanwhile
    ]
    return tuple(sorted(found, key=lambda trouble: (URGENCY[trouble.status], trouble.key)))


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
    detail
        What happens in it, in words.
    fraction
        Estimated part of its work that is done, 0 to 1; None if unknown.
    seconds, seconds_left
        Time since the stage began, and until it ends; None if unknown.
    finished, total
        Cells with an outcome, and all planned cells of this run.
    outcomes
        Numbers of cells by outcome, with the names of `calcidem.ends.CellStatus`.
    contents
        (content in percent, finished cells, planned cells), ascending.
    """

    stage: RunStage
    detail: str = ""
    fraction: float | None = None
    seconds: float = 0.0
    seconds_left: float | None = None
    finished: int = 0
    total: int = 0
    outcomes: Mapping[str, int] = field(default_factory=dict)
    contents: tuple[tuple[float, int, int], ...] = ()

    @classmethod
    def of_cells(cls, status: CampaignStatus, workers: int | None = None) -> Self:
        """Progress of the cells of a campaign on a number of workers, by default those of its last run."""
        total = sum(status.counts.values())
        finished = total - status.pending
        outcomes = {str(kind): number for kind, number in status.counts.items() if kind is not CellStatus.PENDING}
        words = [f"{number} {CellStatus(name).words}" for name, number in sorted(outcomes.items()) if name != "done"]
        left = status.seconds_left * status.workers / (workers or status.workers)
        return cls(
            RunStage.COMPUTING,
            ", ".join([f"{finished} of {total} cells", *words]),
            finished / total if total else None,
            seconds_left=left if math.isfinite(left) else None,
            finished=finished,
            total=total,
            outcomes=outcomes,
            contents=tuple(
                (one.content, len(one.statuses) - one.counts.get(CellStatus.PENDING, 0), len(one.statuses))
                for one in status.contents
            ),
        )


class ProgressDisplay:
    """Display of a run: a bar at the bottom of a terminal, lines of a log, or calls of a function.

    Parameters
    ----------
    console
        Receives sentences and the progress; None for silence.
    callback
        Receives the progress instead; its exceptions end the run.
    shows_progress
        Whether the console shows more than sentences.
    with_advice
        Whether these contain advice, which Python's warnings show, too.
    """

    def __init__(
        self,
        console: Console | None = None,
        callback: Callable[[RunProgress], object] | None = None,
        *,
        shows_progress: bool = True,
        with_advice: bool = True,
    ) -> None:
        self._console, self._callback = console, callback
        self._shows_progress = (shows_progress and console is not None) or callback is not None
        self._bars: Bars | None = None
        if shows_progress and console is not None and console.is_terminal and not console.is_jupyter:
            columns = [
                SpinnerColumn("line"),
                TextColumn("{task.description}", table_column=Column(min_width=9, no_wrap=True)),
                *([BarColumn(min(20, console.width - 65))] if console.width >= 75 else []),  # the text comes first
                TextColumn("{task.fields[text]}"),
            ]
            self._bars = Bars(*columns, console=console, transient=True, refresh_per_second=4)
            self._task = self._bars.add_task("", total=None, text="", visible=False)
        if console is not None:
            # Rich would exit where the reader of the console has ended.
            console.on_broken_pipe = lambda: send_nowhere(console.file)  # type: ignore[method-assign]
        self._listening = nullcontext() if console is None else listening(self._note, with_advice=with_advice)
        self._stage: RunStage | None = None
        self._began = self._next = time.monotonic()
        self._pause = 0.0

    @property
    def is_due(self) -> bool:
        """Whether the next snapshot would be shown."""
        return self._shows_progress and time.monotonic() >= self._next

    def show(self, progress: RunProgress, *, at_once: bool = False) -> None:
        """Show the progress if it is due or a stage begins; a log gets a line less and less often."""
        now = time.monotonic()
        begins = progress.stage is not self._stage
        if not self._shows_progress or not (at_once or begins or self.is_due):
            return
        if begins:
            self._stage, self._began = progress.stage, now
            self._pause = 5.0  # s, so that a short run writes some lines; a run of days does not fill its log
        progress = replace(progress, seconds=now - self._began)
        self._next = now + 0.2
        left = "" if progress.seconds_left is None else f", {duration(progress.seconds_left)} left"
        if self._callback is not None:
            self._callback(progress)
        elif self._bars is not None:
            self._bars.update(
                self._task,
                description=progress.stage.capitalize(),
                total=None if progress.fraction is None else 1.0,
                completed=progress.fraction or 0.0,
                text=f"{progress.detail}, {duration(progress.seconds)}{left}".lstrip(", "),
                visible=True,
            )
        else:
            self._next = now + self._pause
            self._pause = min(1.5 * self._pause, 600.0)
            self._note(f"{time.strftime('%H:%M:%S')} {progress.stage}: {progress.detail}{left}")

    def _note(self, text: str) -> None:
        """Write a sentence that remains visible."""
        if self._console is not None:
            self._console.print(printable(text), markup=False, highlight=False, soft_wrap=not self._console.is_terminal)

    def write(self, line: str) -> None:
        """Write a line of another program unchanged, with its colours; a closed terminal is not an error."""
        if self._console is not None:
            with suppress(OSError):
                self._console.print(Text.from_ansi(line), soft_wrap=True)

    def __enter__(self) -> Self:
        """Begin."""
        self._listening.__enter__()
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Clear the display."""
        self._listening.__exit__(None, None, None)
        if self._bars is not None:
            with suppress(OSError):
                self._bars.stop()


class ProgressReporter(Progress):
    """Sends the progress of a run to a display.

    Attributes
    ----------
    read
        Reads the status of the campaign from its database, for the progress of its cells; None before it exists.
    """

    def __init__(self, display: ProgressDisplay) -> None:
        self._display = display
        self.read: Callable[[], CampaignStatus] | None = None
        self._workers: int | None = None
        self._next = 0.0

    def begin(self, stage: RunStage, detail: str = "") -> None:
        """Report the beginning of a stage without further progress."""
        self._display.show(RunProgress(stage, detail))

    def on_packing(self, packing: "PackingStage") -> None:
        """Report the progress of the packing."""
        step, steps = packing.expansion_step, packing.expansion_steps
        part = f"radius step {step} of {steps}" if step <= steps else "pressed by the lid"
        part = part if packing.steps else "kernels are compiled or loaded"
        self._display.show(RunProgress(RunStage.PACKING, part, packing.fraction or None))

    def on_compiling(self, kernel: str, function: str, functions: int) -> None:
        """Report the function of a kernel that is compiled, and the number of finished ones."""
        self._display.show(RunProgress(RunStage.COMPILING, f"{kernel}, function {functions + 1}, {function}"))

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Report the number of cells."""
        self._workers = workers or None
        total = pluralize(sum(len(batch.cells) for batch in batches), "cell")
        where = pluralize(workers, "worker") if workers else "the workers of the executor"
        parts = f"{pluralize(len(batches), 'batch', 'batches')} on {where}"
        tell(f"{total} in {parts}" if batches else "Nothing to compute: no cell of this run is pending.")
        self.show_cells(at_once=True)

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Report a failure."""
        if outcome.failure is not None:
            cells = ", ".join(f"seed {seed}, {content:g} %" for seed, content in outcome.batch.cells)
            place = f"rank {outcome.rank} ({outcome.host})"
            tell(f"{outcome.failure.kind}: {cells} on {place}: {outcome.failure.message}")

    def on_heartbeat(self) -> None:
        """Report the progress of the cells if it is due."""
        self.show_cells()

    def on_end(self, end: SweepEnd) -> None:
        """Report the end."""
        self.show_cells(at_once=True)
        failures = (CellStatus.FAILED, CellStatus.TIMED_OUT, CellStatus.QUARANTINED)
        parts = [
            f"{end.state} after {duration(end.seconds)}",
            f"{end.tally.total()} cells settled",
            *(f"{end.tally[kind]} {kind.words}" for kind in failures if end.tally[kind]),
            end.detail,
        ]
        tell(", ".join(part for part in parts if part))

    def show_cells(self, *, at_once: bool = False) -> None:
        """Read and show the progress of the cells; reading takes a twentieth of the time at most."""
        begin = time.monotonic()
        if self.read is None or not (at_once or (self._display.is_due and begin >= self._next)):
            return
        with suppress(StoreError):  # what stores or reads next explains it
            self._display.show(RunProgress.of_cells(self.read(), self._workers), at_once=at_once)
        self._next = begin + max(1.0, 20.0 * (time.monotonic() - begin))


def choose_display(progress: Callable[[RunProgress], object] | bool | None) -> ProgressDisplay:
    """Display for Python: a function, True, False, or by default one on a terminal and in a notebook."""
    if callable(progress):
        return ProgressDisplay(callback=progress)
    console = Console(highlight=False)
    is_watched = console.is_jupyter or (console.is_terminal and launcher() is None)
    shown = console if progress or (progress is None and is_watched) else None
    return ProgressDisplay(shown, with_advice=False)
