"""What a person sees while a sweep runs: a bar on a terminal, lines in a log."""

import time
from collections.abc import Sequence
from typing import Any

import rich.progress
from rich.console import Console

from calcidem.sweep.batch import Batch
from calcidem.sweep.forecast import Forecast
from calcidem.sweep.outcome import BatchOutcome, Place
from calcidem.sweep.sweep_end import SweepEnd


class Progress:
    """What a sweep tells about itself, on rank 0 only; this one takes it and shows nothing."""

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


class _ConsoleProgress(Progress):
    """Counts, and tells failures, lost workers and the end at once."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._forecast = Forecast([])

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:  # noqa: ARG002 - for those derived from it
        """Begin to count."""
        self._forecast = Forecast(batches)

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Count, and tell of a failure."""
        self._forecast.record(outcome)
        if outcome.failure is not None:
            cells, place = ", ".join(str(cell) for cell in outcome.batch.cells), outcome.place
            self._tell(
                f"{outcome.failure.kind}: {cells} on rank {place.rank} ({place.host}): {outcome.failure.message}"
            )

    def on_loss(self, place: Place, reason: str) -> None:
        """Tell which worker is lost."""
        self._tell(f"lost rank {place.rank} ({place.host}): {reason}")

    def on_end(self, end: SweepEnd) -> None:
        """Tell how it ended."""
        self._tell(_end_line(end))

    def _tell(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False)


class LineProgress(_ConsoleProgress):
    """Writes a line now and then, for logs of batch systems.

    The pause between two lines starts at `shortest` seconds and grows by half each time up to `longest`, so
    that a short run shows something and a run of days doesn't fill its log.

    Parameters
    ----------
    console
        Where to write.
    shortest, longest
        Limits of the pause in s.
    """

    def __init__(self, console: Console, shortest: float = 5.0, longest: float = 600.0) -> None:
        super().__init__(console)
        self._pause = shortest
        self._longest = longest
        self._next = time.monotonic() + shortest

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Write how much there is to do."""
        super().on_start(batches, workers)
        self._tell(f"{self._forecast.total} cells in {len(batches)} batches on {pluralize(workers, 'worker')}")

    def on_heartbeat(self, workers: int, running: int) -> None:  # noqa: ARG002 - the bar shows it
        """Write how far the sweep is, if it is time to."""
        if time.monotonic() < self._next:
            return
        self._pause = min(1.5 * self._pause, self._longest)
        self._next = time.monotonic() + self._pause
        done, total = self._forecast.settled, self._forecast.total
        left = duration(self._forecast.seconds_left(workers))
        self._tell(f"{done} of {total} cells ({done / max(total, 1):.0%}), {left} left, {pluralize(workers, 'worker')}")

    def _tell(self, line: str) -> None:
        self._console.print(f"{time.strftime('%H:%M:%S')} {line}", markup=False, highlight=False, soft_wrap=True)


class BarProgress(_ConsoleProgress):
    """Draws a bar with the time left on a terminal, and writes above it.

    The bar is drawn at the sweep's own heartbeats and not by a thread, which would cost as much as the master.
    """

    def __init__(self, console: Console) -> None:
        super().__init__(console)
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
        super().on_start(batches, workers)
        self._bar.update(self._task, total=self._forecast.total, workers=pluralize(workers, "worker"))
        self._bar.start()

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
        super().on_end(end)


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
