"""What a person sees while a sweep runs: a bar on a terminal, lines in a log."""

import time
from collections.abc import Sequence
from typing import Any, Protocol

import rich.progress
from rich.console import Console

from calcidem.sweep.batch import Batch
from calcidem.sweep.forecast import Forecast
from calcidem.sweep.outcome import BatchOutcome, Place
from calcidem.sweep.sweep_end import SweepEnd


class Progress(Protocol):
    """What a sweep tells about itself, on rank 0 only."""

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Take note of the batches that are about to be handed out to so many workers."""

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Take note that an outcome is stored."""

    def on_loss(self, place: Place, reason: str) -> None:
        """Take note that a worker is lost."""

    def on_heartbeat(self, workers: int, running: int) -> None:
        """Take note, twice a second, that rank 0 is at work, with so many workers left, some of them computing."""

    def on_end(self, end: SweepEnd) -> None:
        """Take note that the sweep has ended."""


class SilentProgress:
    """Tells nothing."""

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Tell nothing."""

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Tell nothing."""

    def on_loss(self, place: Place, reason: str) -> None:
        """Tell nothing."""

    def on_heartbeat(self, workers: int, running: int) -> None:
        """Tell nothing."""

    def on_end(self, end: SweepEnd) -> None:
        """Tell nothing."""


class LineProgress:
    """Writes a line now and then, for logs of batch systems.

    The pause between two lines starts at `shortest` seconds and grows by half each time up to `longest`, so
    that a short run shows something and a run of days doesn't fill its log. Failures and lost workers are
    told at once.

    Parameters
    ----------
    console
        Where to write.
    shortest, longest
        Limits of the pause in s.
    """

    def __init__(self, console: Console, shortest: float = 5.0, longest: float = 600.0) -> None:
        self._console = console
        self._pause = shortest
        self._longest = longest
        self._next = time.monotonic() + shortest
        self._forecast = Forecast([])

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Write how much there is to do."""
        self._forecast = Forecast(batches)
        self._write(f"{self._forecast.total} cells in {len(batches)} batches on {pluralize(workers, 'worker')}")

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Count, and write if the batch failed."""
        self._forecast.record(outcome)
        if outcome.failure is not None:
            self._write(_failure_line(outcome))

    def on_loss(self, place: Place, reason: str) -> None:
        """Write which worker is lost."""
        self._write(_loss_line(place, reason))

    def on_heartbeat(self, workers: int, running: int) -> None:  # noqa: ARG002 - the bar shows it
        """Write how far the sweep is, if it is time to."""
        if time.monotonic() < self._next:
            return
        self._pause = min(1.5 * self._pause, self._longest)
        self._next = time.monotonic() + self._pause
        done, total = self._forecast.settled, self._forecast.total
        left = duration(self._forecast.seconds_left(workers))
        self._write(
            f"{done} of {total} cells ({done / max(total, 1):.0%}), {left} left, {pluralize(workers, 'worker')}"
        )

    def on_end(self, end: SweepEnd) -> None:
        """Write how it ended."""
        self._write(_end_line(end))

    def _write(self, line: str) -> None:
        self._console.print(f"{time.strftime('%H:%M:%S')} {line}", markup=False, highlight=False, soft_wrap=True)


class BarProgress:
    """Draws a bar with the time left on a terminal.

    The bar is drawn at the sweep's own heartbeats and not by a thread, which would cost as much as the master.

    Parameters
    ----------
    console
        The terminal.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._forecast = Forecast([])
        self._bar = rich.progress.Progress(
            rich.progress.TextColumn("{task.description}"),
            rich.progress.BarColumn(),
            rich.progress.MofNCompleteColumn(),
            rich.progress.TextColumn("cells"),
            rich.progress.TimeElapsedColumn(),
            rich.progress.TextColumn("{task.fields[left]} left"),
            rich.progress.TextColumn("{task.fields[workers]}"),
            console=console,
            auto_refresh=False,
        )
        self._task = self._bar.add_task("computing", total=None, left="?", workers="")

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Draw the empty bar."""
        self._forecast = Forecast(batches)
        self._bar.update(self._task, total=self._forecast.total, workers=pluralize(workers, "worker"))
        self._bar.start()

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Count, and write a line above the bar if the batch failed."""
        self._forecast.record(outcome)
        if outcome.failure is not None:
            self._console.print(_failure_line(outcome), markup=False, highlight=False)

    def on_loss(self, place: Place, reason: str) -> None:
        """Write a line above the bar."""
        self._console.print(_loss_line(place, reason), markup=False, highlight=False)

    def on_heartbeat(self, workers: int, running: int) -> None:
        """Draw the bar again."""
        self._bar.update(
            self._task,
            completed=self._forecast.settled,
            left=duration(self._forecast.seconds_left(workers)),
            workers=f"{running} of {pluralize(workers, 'worker')} busy",
        )
        self._bar.refresh()

    def on_end(self, end: SweepEnd) -> None:
        """Draw the bar for the last time and write how it ended."""
        self._bar.update(self._task, completed=self._forecast.settled, left="0 s", workers="")
        self._bar.stop()
        self._console.print(_end_line(end), markup=False, highlight=False)


def progress_for(console: Console) -> Progress:
    """Return the display that suits a console: a bar on a terminal, lines anywhere else."""
    return BarProgress(console) if console.is_terminal else LineProgress(console)


def duration(seconds: float | None) -> str:
    """Return a duration for a person: `42 s`, `7 min`, `3 h 20 min`, `2 d 4 h`, or `?` if it is unknown."""
    if seconds is None:
        return "?"
    if seconds < 100:  # noqa: PLR2004 - two digits are enough for a person
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 100:  # noqa: PLR2004 - as above
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:  # noqa: PLR2004 - two days
        return f"{hours} h {minutes:02d} min"
    days, hours = divmod(hours, 24)
    return f"{days} d {hours} h"


def _failure_line(outcome: BatchOutcome[Any, Any]) -> str:
    """Return one line about a batch that failed."""
    if outcome.failure is None:
        raise ValueError(f"batch {outcome.batch.identifier} has not failed")
    cells = ", ".join(str(cell) for cell in outcome.batch.cells)
    place = outcome.place
    return f"{outcome.failure.kind}: {cells} on rank {place.rank} ({place.host}): {outcome.failure.message}"


def _loss_line(place: Place, reason: str) -> str:
    """Return one line about a lost worker."""
    return f"lost rank {place.rank} ({place.host}): {reason}"


def _end_line(end: SweepEnd) -> str:
    """Return one line about how a sweep ended."""
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


def pluralize(number: int, noun: str) -> str:
    """Return a number with its noun: `1 worker`, `2 workers`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
