"""A rank's words to the command that started it, over the connection that its starter has made."""

import os
import socket
from contextlib import suppress
from functools import cache

from calcidem.sweep.starter import DESCRIPTOR_VARIABLE

_heard = bytearray()
"""Of the command, up to the last whole line."""


def tell_command(text: str) -> None:
    """Tell the command a line, if there is one that listens.

    loaded          this rank has loaded its program and looks for the others
    joined          it has found all of them
    sweeping        the cells are being computed, and a lost worker costs only its batch (rank 0)
    beat, pause     rank 0 is at work and beats every half second; it stops beating, and may be busy for long
    exit N SIGNAL   the program ends with exit code N, because of a signal or none (rank 0)
    """
    if (connection := _connection()) is not None:
        with suppress(OSError):  # the command is gone; the launcher or the starter will end this process
            connection.sendall(f"{text}\n".encode())


def command_listens() -> bool:
    """Whether this process was started by a command that listens, and ends what is left when rank 0 has ended."""
    return _connection() is not None


def lost_according_to_command() -> dict[int, str]:
    """Ranks that are lost as the command now knows from their starters, with reasons, each told once; for rank 0."""
    connection = _connection()
    if connection is None:
        return {}
    with suppress(OSError):  # nothing new, or the command is gone
        _heard.extend(connection.recv(1 << 16, socket.MSG_DONTWAIT))
    end = _heard.rfind(b"\n") + 1
    lines = bytes(_heard[:end]).decode(errors="replace").splitlines()
    del _heard[:end]
    return {int(rank): reason for _, rank, reason in (line.split(" ", 2) for line in lines)}


@cache
def _connection() -> socket.socket | None:
    """The connection, in whose other end the starter writes too; None if this process was started in another way."""
    descriptor = os.environ.get(DESCRIPTOR_VARIABLE)
    return None if descriptor is None else socket.socket(fileno=int(descriptor))
