"""``calcidem run --serve``: the live page in a process of its own, of low priority, as long as the run lasts."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from calcidem.app.serve.address import PageAddress

_TIME_TO_TELL = 3.0
"""Seconds that the page has for telling browsers how the run has ended."""


@contextmanager
def page_beside_run(database: str | os.PathLike[str], campaign: str, say: Callable[[str], None]) -> Iterator[None]:
    """Show a campaign, which may not have begun, in the browser while the block runs; say the address.

    `OSError` if the page can't be opened.
    """
    address = PageAddress.take()
    descriptor = address.listener.fileno()
    process = subprocess.Popen(
        [sys.executable, "-m", "calcidem.app.serve"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        pass_fds=[descriptor],
        process_group=0,  # Ctrl-C is for the run, which ends in order
    )
    told = {"database": os.fspath(database), "campaign": campaign, "descriptor": descriptor}
    assert process.stdin is not None  # noqa: S101 - it is a pipe
    with suppress(BrokenPipeError), process.stdin as stream:
        stream.write(json.dumps(told | {"host": address.host, "token": address.token}).encode())
    address.listener.close()
    say(f"Live page: {address.url}")
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(_TIME_TO_TELL)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
