"""Output on a terminal: text that cannot control it, and a log of unexpected errors. Loads no large library."""

import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from datetime import UTC, datetime
from io import TextIOWrapper
from pathlib import Path

from calcidem.storage.passwords import hide_passwords
from calcidem.sweep.environment import TERMINAL_VARIABLE, launcher
from calcidem.version import __version__

_ESCAPES = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\n\t"}
"""Control characters (Unicode category Cc, ECMA-48), which move the cursor, colour, or make a terminal answer."""


IS_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)
"""Whether only results and errors are written; each command sets it."""

IS_VERBOSE: ContextVar[bool] = ContextVar("verbose", default=False)
"""Whether tracebacks of errors and the time that a command took are wanted, too."""


def tell(text: str) -> None:
    """Write the progress, apart from the result."""
    if not IS_QUIET.get():
        sys.stderr.write(printable(f"{text}\n"))
        sys.stderr.flush()


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Give a function that receives the numbers of finished and of all parts, for a bar on a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=IS_QUIET.get() or not console.is_terminal) as progress:
        task = progress.add_task(title)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def be_plain_under_mpi() -> None:
    """Have a rank write no colours and move no cursor unless the command that started it has a terminal.

    mpirun gives its ranks a pseudo-terminal, also where a file or a pipe takes what they write.
    """
    if launcher() is not None and TERMINAL_VARIABLE not in os.environ:
        os.environ["TERM"] = "dumb"


def printable(text: object) -> str:
    """Text that a terminal shows and does not obey: control characters but line feed and tab as escapes."""
    return str(text).translate(_ESCAPES)


def print_any_text() -> None:
    """Have output written in any encoding: what it lacks, and parts of file names that are no text, as escapes."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def strange_argument(arguments: Sequence[str]) -> str:
    """What is wrong with an argument that has control characters, for a person; empty if none has."""
    for number, argument in enumerate(arguments, 1):
        if (shown := printable(argument)) != argument:
            return f"argument {number} = '{shown}': has control characters; write it without, or rename the file"
    return ""


def log_error(error: BaseException) -> Path | None:
    """Write the traceback into a new file, in this folder or the one for temporary files; None if none can be made."""
    program = f"calcidem {__version__}, Python {platform.python_version()}, {platform.platform()}"
    text = hide_passwords("\n".join([program, repr(sys.argv), "".join(traceback.format_exception(error))]))
    name = f"calcidem-error-{datetime.now(UTC):%Y%m%d-%H%M%S}-{os.getpid()}.log"
    for folder in (Path.cwd, tempfile.gettempdir):
        with suppress(OSError):
            path = Path(folder()) / name
            path.write_text(text, encoding="utf-8", errors="backslashreplace")
            return path
    return None
