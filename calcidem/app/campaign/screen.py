"""Terminal of the command that starts the ranks: the progress, and above it the output of the ranks."""

import os
import subprocess
import sys
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Self

from calcidem.app.campaign.progress import RunProgress, RunStage

if TYPE_CHECKING:
    from calcidem.app.campaign.display import LiveDisplay  # rich, which only a terminal needs

_MOST_BYTES = 1 << 16
"""Number of bytes read from a pipe at once."""


class CommandScreen:
    """A context manager that receives the standard output and error of the ranks' launcher.

    On a terminal it reads both from pipes and writes them line by line above the display. Elsewhere the launcher writes
    directly, and rank 0 writes lines instead of the display.
    """

    def __init__(self) -> None:
        self._display: LiveDisplay | None = None
        self._pipes: dict[IO[bytes], bytes] = {}
        self._shown = ""

    def __enter__(self) -> Self:
        """Use the terminal, if any."""
        if sys.stdout.isatty():
            from rich.console import Console  # noqa: PLC0415 - only a terminal needs it

            from calcidem.app.campaign.display import LiveDisplay  # noqa: PLC0415 - as above

            self._display = LiveDisplay(Console(highlight=False), by_itself=False)
            self._display.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        """Restore the terminal."""
        if self._display is not None:
            self._display.__exit__()

    @property
    def outputs(self) -> tuple[int | None, int | None]:
        """Arguments of `subprocess.Popen` for the launcher's standard output and error."""
        if self._display is None:
            return None, None
        return subprocess.PIPE, subprocess.PIPE if sys.stderr.isatty() else None

    def begin(self, process: "subprocess.Popen[bytes]", ranks: int) -> None:
        """Receive the output of this launcher, which starts so many ranks."""
        if self._display is None:
            return
        self._display.show(RunProgress(RunStage.STARTING, workers=ranks - 1))
        self._pipes = {pipe: b"" for pipe in (process.stdout, process.stderr) if pipe is not None}
        for pipe in self._pipes:
            os.set_blocking(pipe.fileno(), False)

    def update(self, progress: str) -> None:
        """Write the output of the ranks, and draw the progress; ``progress`` is the last snapshot of rank 0."""
        if self._display is None:
            return
        for pipe in self._pipes:
            self._read(pipe)
        if progress != self._shown:
            self._shown = progress
            with suppress(ValueError, KeyError, TypeError):
                self._display.show(RunProgress.from_json(progress))
        self._display.refresh()

    def end(self) -> None:
        """Write the rest of the launcher's output."""
        for pipe in self._pipes:
            self._read(pipe)
            if rest := self._pipes[pipe]:
                self._write(rest)
            pipe.close()
        self._pipes = {}

    def say(self, text: str) -> None:
        """Write a message of the command itself."""
        if self._display is not None and sys.stderr.isatty():
            self._display.note(text)
        else:
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()

    def _read(self, pipe: IO[bytes]) -> None:
        """Write the complete lines in a pipe."""
        with suppress(BlockingIOError):
            while data := os.read(pipe.fileno(), _MOST_BYTES):
                lines, newline, rest = (self._pipes[pipe] + data).rpartition(b"\n")
                self._pipes[pipe] = rest
                if newline:
                    self._write(lines)

    def _write(self, lines: bytes) -> None:
        """Write lines above the display, with their colours; a closed terminal is not an error."""
        from rich.text import Text  # noqa: PLC0415 - only a terminal needs it

        with suppress(OSError):
            for line in lines.decode(errors="replace").split("\n"):
                self._display.console.print(Text.from_ansi(line.rstrip("\r")), soft_wrap=True)  # type: ignore[union-attr]
