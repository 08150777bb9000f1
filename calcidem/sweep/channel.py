"""A rank's words to the command that started it, over the connection that its starter has made."""

import os
import socket
from contextlib import suppress
from functools import cache

from calcidem.sweep.starter import DESCRIPTOR_VARIABLE

_MOST_UNHEARD = 4
"""Pictures of the progress that may be under way to the command; one that is busy or stopped gets no more."""

_heard = bytearray()
"""Of the command, up to the last whole line."""

_lost: dict[int, str] = {}
"""Ranks that the command has called lost, and that were not asked for yet."""

_unheard: list[None] = []
"""One entry for each picture of the progress that the command has not taken yet."""


def tell_command(text: str) -> None:
    """Tell the command a line, if there is one that listens.

    loaded          this rank has loaded its program and looks for the others
    joined          it has found all of them
    sweeping        the cells are being computed, and a lost worker costs only its batch (rank 0)
    beat, pause     rank 0 is at work and beats every half second; it stops beating, and may be busy for long
    exit N SIGNAL   the program ends with exit code N, because of a signal or none (rank 0)

    and rank 0, with `tell_progress`:

    progress JSON   how far the run is, for the display
    """
    if (connection := _connection()) is not None:
        with suppress(OSError):  # the command is gone; the launcher or the starter will end this process
            connection.sendall(f"{text}\n".encode())


def command_listens() -> bool:
    """Whether this process was started by a command that listens, and ends what is left when rank 0 has ended."""
    return _connection() is not None


def tell_progress(text: str) -> None:
    """Tell the command how far the run is, unless it has not taken what was told before: nothing waits for a display.

    Were it not for that, a command that is stopped would fill its socket and be taken for lost.
    """
    _listen()
    if len(_unheard) < _MOST_UNHEARD:
        _unheard.append(None)
        tell_command(f"progress {text}")


def lost_according_to_command() -> dict[int, str]:
    """Ranks that are lost as the command now knows from their starters, with reasons, each told once; for rank 0."""
    _listen()
    lost = dict(_lost)
    _lost.clear()
    return lost


def _listen() -> None:
    """Take in what the command says: `lost RANK REASON`, or `heard` for each picture of the progress."""
    if (connection := _connection()) is None:
        return
    with suppress(OSError):  # nothing new, or the command is gone
        _heard.extend(connection.recv(1 << 16, socket.MSG_DONTWAIT))
    end = _heard.rfind(b"\n") + 1
    lines = bytes(_heard[:end]).decode(errors="replace").splitlines()
    del _heard[:end]
    for line in lines:
        word, _, rest = line.partition(" ")
        if word == "lost":
            rank, _, reason = rest.partition(" ")
            _lost[int(rank)] = reason
        elif _unheard:
            _unheard.pop()


@cache
def _connection() -> socket.socket | None:
    """The connection, in whose other end the starter writes too; None if this process was started in another way."""
    descriptor = os.environ.get(DESCRIPTOR_VARIABLE)
    return None if descriptor is None else socket.socket(fileno=int(descriptor))
