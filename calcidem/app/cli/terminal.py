"""Output on a terminal, with text that cannot control it. Imports no large library."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from calcidem.app.campaign.notices import printable

IS_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)
"""Whether only results and errors are written; each command sets it."""

IS_VERBOSE: ContextVar[bool] = ContextVar("verbose", default=False)
"""Whether tracebacks of errors and the time of a command are wanted, too."""


def write_notice(text: str) -> None:
    """Write a sentence to standard error, separate from the result."""
    sys.stderr.write(printable(f"{text}\n"))
    sys.stderr.flush()


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Return a function that receives the numbers of finished and of all parts, for a bar on a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=IS_QUIET.get() or not console.is_terminal) as progress:
        task = progress.add_task(title)
        yield lambda done, total: progress.update(task, completed=done, total=total)
