"""Where the live page can be opened: a port that is free, and a token that nobody guesses. It loads nothing large."""

import errno
import importlib.util
import secrets
import socket
from dataclasses import dataclass, field

_USUAL_HOST = "127.0.0.1"

_NEEDED = ("starlette", "uvicorn")


class PageAddressError(OSError):
    """A live page that can't be opened; the message names field, value and cure."""


@dataclass(frozen=True, slots=True)
class PageAddress:
    """A socket that listens, and the secret of the page behind it.

    Attributes
    ----------
    listener
        The socket.
    host
        Its name, as it was given.
    token
        What opens the page.
    """

    listener: socket.socket
    host: str
    token: str = field(repr=False)

    @property
    def port(self) -> int:
        """Its port."""
        port: int = self.listener.getsockname()[1]
        return port

    def __str__(self) -> str:
        """Give what to type into a browser."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/?token={self.token}"


def take_address(host: str, port: int) -> PageAddress:
    """Listen on a port, 0 for any that is free.

    Raises
    ------
    PageAddressError
        If the port is in use or not to be had, the host is none of this machine, or a library is not installed.
    """
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise PageAddressError(
            f"the live page needs {' and '.join(missing)}; install it: pip install 'calcidem[serve]'"
        )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise PageAddressError(_explained(error, host, port)) from error
    return PageAddress(listener, host, secrets.token_urlsafe(32))


def _explained(error: OSError, host: str, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"--port {port} is in use on {host}; give another, or 0 for any that is free"
    if error.errno == errno.EACCES:
        return f"--port {port} needs more rights than you have; give one above 1023, or 0 for any that is free"
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return f"--host {host} is no address of this machine; give {_USUAL_HOST}, or one that 'hostname -I' lists"
    return f"--host {host} --port {port}: {error.strerror}; give others"
