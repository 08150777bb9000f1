"""Displays of the progress: at the bottom of a terminal, as lines of a log, or by a function of the caller."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Self

from rich.columns import Columns
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from calcidem.app.campaign.progress import ProgressDisplay, RunProgress, RunStage
from calcidem.launch.channel import command_listens, tell_progress
from calcidem.sweep.environment import launcher
from calcidem.sweep.progress import duration, pluralize

_FRAMES_PER_SECOND = 4

_BAR_WIDTH = 24

_SPINNER = "|/-\\"

_MOST_CONTENTS = 20

_SHORTEST_PAUSE, _LONGEST_PAUSE = 5.0, 600.0
"""Shortest and longest seconds between two lines of a log. The pause grows by half each time, so that a short run shows
some lines and a run of days does not fill its log.
"""


class _CallbackDisplay(ProgressDisplay):
    """Passes the progress to a function of the caller, whose exceptions end the run."""

    def __init__(self, callback: Callable[[RunProgress], object]) -> None:
        self._callback = callback

    def show(self, progress: RunProgress) -> None:
        """Pass it on."""
        self._callback(progress)


class _ConsoleDisplay(ProgressDisplay):
    """Writes sentences on a console."""

    def __init__(self, console: Console) -> None:
        self.console = console

    def note(self, text: str) -> None:
        """Write a line, above the display if there is one."""
        self.console.print(text, markup=False, highlight=False, soft_wrap=True)


class _LineDisplay(_ConsoleDisplay):
    """Writes lines at increasing intervals, for logs of batch systems and for pipes; the shortest is in seconds."""

    def __init__(self, console: Console, shortest: float = _SHORTEST_PAUSE) -> None:
        super().__init__(console)
        self._shortest = self._pause = shortest
        self._next = time.monotonic() + shortest
        self._stage = RunStage.STARTING

    def show(self, progress: RunProgress) -> None:
        """Write the progress if it is due."""
        if progress.stage is not self._stage:
            self._stage, self._pause = progress.stage, self._shortest
            self._next = time.monotonic() + self._pause
            if progress.stage is RunStage.COMPILING:
                self.note("compiling the kernels, or taking them from the cache")
        elif time.monotonic() >= self._next:
            self._pause = min(1.5 * self._pause, _LONGEST_PAUSE)
            self._next = time.monotonic() + self._pause
            self.note(", ".join([*_described(progress), *_time_left(progress)]))

    def note(self, text: str) -> None:
        """Write a line with the time."""
        super().note(f"{time.strftime('%H:%M:%S')} {text}")


class _ChannelDisplay(_ConsoleDisplay):
    """Sends the progress to the command that started the ranks, which has the real terminal."""

    def show(self, progress: RunProgress) -> None:
        """Send it; nothing waits for the command, which may skip snapshots."""
        tell_progress(progress.to_json())


class LiveDisplay(_ConsoleDisplay):
    """Draws the progress at the bottom of a terminal; other text appears above it.

    A thread redraws it, or the caller of `refresh`.
    """

    def __init__(self, console: Console, *, by_itself: bool = True) -> None:
        super().__init__(console)
        self._progress: RunProgress | None = None
        self._since = time.monotonic()
        self._live = Live(
            get_renderable=self._picture,
            console=console,
            auto_refresh=by_itself,
            refresh_per_second=_FRAMES_PER_SECOND,
            transient=True,
            redirect_stdout=by_itself,
            redirect_stderr=by_itself and sys.stderr.isatty(),
        )
        self._next = 0.0

    def show(self, progress: RunProgress) -> None:
        """Set the progress to draw."""
        self._progress, self._since = progress, time.monotonic()

    def refresh(self) -> None:
        """Draw again if due; a closed terminal is not an error."""
        if (now := time.monotonic()) >= self._next:
            self._next = now + 1.0 / _FRAMES_PER_SECOND
            with suppress(OSError):
                self._live.refresh()

    def __enter__(self) -> Self:
        """Begin drawing."""
        self._live.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Clear the display."""
        with suppress(OSError):
            self._live.stop()

    def _picture(self) -> Group:
        """Display of the present progress."""
        if self._progress is None:
            return Group()
        progress, passed = self._progress, time.monotonic() - self._since
        spinner = _SPINNER[int(_FRAMES_PER_SECOND * time.monotonic()) % len(_SPINNER)]
        head = Table.grid(padding=(0, 1))
        part = progress.finished / progress.total if progress.total else progress.fraction
        bar = ProgressBar(1.0, part, _BAR_WIDTH, pulse=not part, animation_time=time.monotonic())
        summary, *details = _described(progress)
        elapsed = ", ".join([duration(progress.seconds + passed), *_time_left(progress, passed)])
        head.add_row(
            spinner, Text(progress.stage.capitalize(), style="bold"), bar, summary, Text(elapsed, style="cyan")
        )
        lines = [Text(f"  {', '.join(details)}", no_wrap=True, overflow="ellipsis")] if details else []
        contents = Columns(
            [
                Text(f"  {content:g} %: {finished}/{total}", style="dim" if finished == total else "")
                for content, finished, total in progress.contents[:_MOST_CONTENTS]
            ],
            equal=True,
        )
        return Group(head, *lines, contents)


def choose_display(progress: Callable[[RunProgress], object] | bool | None) -> ProgressDisplay:
    """Display for Python: a function, True, False, or the default."""
    if callable(progress):
        return _CallbackDisplay(progress)
    console = Console(highlight=False)
    is_terminal = console.is_terminal and launcher() is None  # mpirun gives a rank a pseudo-terminal that nobody reads
    if progress is False or not (progress or is_terminal or console.is_jupyter):
        return ProgressDisplay()
    return LiveDisplay(console) if is_terminal and not console.is_jupyter else _LineDisplay(console)


def command_display(console: Console) -> ProgressDisplay:
    """Display of a command: on a terminal, drawn here or by the command that started the ranks; else lines of a log."""
    if not console.is_terminal:
        return _LineDisplay(console)
    return _ChannelDisplay(console) if command_listens() else LiveDisplay(console)


def _described(progress: RunProgress) -> list[str]:
    """Lines about a run, the most important first."""
    match progress.stage:
        case RunStage.STARTING:
            return [pluralize(progress.workers + 1, "rank")] if progress.workers else ["calcidem"]
        case RunStage.PACKING:
            return list(_describe_packing(progress))
        case RunStage.COMPILING:
            if not progress.kernel:
                return ["the kernels, for this kind of processor", "once; then they are taken from a cache"]
            functions = pluralize(progress.functions, "function")
            return [f"the kernel for {progress.kernel}", f"{functions} finished, now {progress.function}"]
        case RunStage.COMPUTING:
            percent = 100.0 * progress.finished / max(progress.total, 1)
            outcomes = [f"{number} {name.replace('_', ' ')}" for name, number in progress.outcomes.items()]
            workers = f"{progress.busy} of {pluralize(progress.workers, 'worker')} busy" if progress.workers else ""
            return [
                f"{progress.finished} of {progress.total} cells ({percent:.0f} %)",
                *outcomes,
                *filter(None, [workers]),
            ]
        case RunStage.WRITING:
            return ["tables and files"]


def _describe_packing(progress: RunProgress) -> Iterator[str]:
    """Progress of a packing."""
    if progress.expansion_step <= progress.expansion_steps:
        yield f"radius step {progress.expansion_step} of {progress.expansion_steps}"
    else:
        yield "pressed by the lid"
    ratio = "" if progress.unbalanced_ratio is None else f"{progress.unbalanced_ratio:.1e}"
    yield f"unbalanced-force ratio {ratio}" + (
        f", at rest {progress.target_ratio:.0e}" if progress.target_ratio else ""
    )
    yield f"{progress.time_steps:,} time steps"


def _time_left(progress: RunProgress, passed: float = 0.0) -> list[str]:
    """Time left some seconds after this snapshot, if known."""
    left = progress.seconds_left
    return [] if left is None else [f"{duration(max(left - passed, 0.0))} left"]
