"""Live page: campaigns in a browser during and after their runs. It only reads databases.

Here are its address, a free port and a token that cannot be guessed, and the page of a run. This loads nothing large.
"""

import errno
import importlib.util
import json
import os
import secrets
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Self


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Listening socket, and secret token of the page."""

    listener: socket.socket
    """The socket."""
    host: str
    """Host name as given."""
    token: str = field(repr=False)
    """Token that opens the page."""
    port: int = field(init=False)
    """Port of the socket."""
    url: str = field(init=False, repr=False)
    """Address for a browser."""

    def __post_init__(self) -> None:
        """Record the port, since the socket may be closed later."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        port = self.listener.getsockname()[1]
        object.__setattr__(self, "port", port)
        object.__setattr__(self, "url", f"http://{host}:{port}/?token={self.token}")

    @classmethod
    def take(cls, host: str = "127.0.0.1", port: int = 0) -> Self:
        """Listen on a port, 0 for any that is free.

        `OSError`, naming field, value and remedy, if the port is in use or forbidden, the host is not of this machine,
        or a library is missing.
        """
        missing = [name for name in ("starlette", "uvicorn") if importlib.util.find_spec(name) is None]
        if missing:
            raise OSError(f"the live page needs {' and '.join(missing)}; install it: pip install 'calcidem[serve]'")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((host, port))
            listener.listen()
        except OSError as error:
            listener.close()
            raise OSError(_explained(error, host, port)) from error
        return cls(listener, host, secrets.token_urlsafe(32))


def _explained(error: OSError, host: str, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"--port {port} is in use on {host}; give another, or 0 for any that is free"
    if error.errno == errno.EACCES:
        return f"--port {port} needs more rights than you have; give one above 1023, or 0 for any that is free"
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return f"--host {host} is not an address of this machine; give 127.0.0.1, or one that 'hostname -I' lists"
    return f"--host {host} --port {port}: {error.strerror}; give others"


@contextmanager
def page_beside_run(database: str | os.PathLike[str], campaign: str, say: Callable[[str], None]) -> Iterator[None]:
    """Show a campaign, which may not have begun, in the browser while the block runs; say the address.

    The page is in a process of its own, of low priority.

    `OSError` if the page can't be opened.
    """
    address = PageAddress.take()
    descriptor = address.listener.fileno()
    process = subprocess.Popen(
        [sys.executable, "-m", "calcidem.app.serve.server"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        pass_fds=[descriptor],
        process_group=0,  # Ctrl-C is for the run, which ends regularly
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
            process.wait(3.0)  # s, in which it reports the end of the run to browsers
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
