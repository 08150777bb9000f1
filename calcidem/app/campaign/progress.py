"""Progress of a run: snapshots of its stage and of the database, and their one display."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bars
from rich.table import Column
from rich.text import Text

from calcidem.app.campaign.notices import listening, printable, tell
from calcidem.app.campaign.status import CampaignStatus
from calcidem.dem.sample.packing import PackingStage
from calcidem.ends import CellStatus
from calcidem.storage.errors import StoreError
from calcidem.sweep.batch import Batch, BatchOutcome
from calcidem.sweep.ranks import launcher
from calcidem.sweep.schedule import Progress, SweepEnd, duration, pluralize


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
        if self._callback is not None:
            self._callback(progress)
        elif self._bars is not None:
            left = "" if progress.seconds_left is None else f", {duration(progress.seconds_left)} left"
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
            left = "" if progress.seconds_left is None else f", {duration(progress.seconds_left)} left"
            self._note(f"{time.strftime('%H:%M:%S')} {progress.stage}: {progress.detail}{left}")

    def _note(self, text: str) -> None:
        """Write a sentence that remains visible."""
        if self._console is not None:
            self._console.print(printable(text), markup=False, highlight=False, soft_wrap=True)

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

    def on_packing(self, packing: PackingStage) -> None:
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
        tell(f"{total} in {parts}" if batches else "Nothing to compute: every cell has an outcome.")
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
        tally = end.tally
        parts = [
            f"{end.state} after {duration(end.seconds)}",
            f"{tally.settled} cells settled",
            f"{tally.failed} failed" if tally.failed else "",
            f"{tally.timed_out} timed out" if tally.timed_out else "",
            f"{tally.quarantined} quarantined" if tally.quarantined else "",
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
