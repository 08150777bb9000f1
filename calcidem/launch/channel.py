"""Messages of a rank to the command that started it, over the connection of its starter."""

import os
import socket
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache

from calcidem.launch.starter import DESCRIPTOR_VARIABLE

_MOST_UNHEARD = 4
"""Number of unacknowledged snapshots of the progress above which the command gets no more: it is busy or stopped."""


@dataclass(slots=True)
class _Command:
    """The command that listens to this process."""

    connection: socket.socket
    """Connection to it; the starter writes to the same end."""
    buffer: bytes = b""
    """Received part of its next line."""
    lost: dict[int, str] = field(default_factory=dict)
    """Ranks that it has reported as lost, with reasons, and that were not read yet."""
    unheard: int = 0
    """Number of snapshots of the progress that it has not acknowledged yet."""

    def say(self, text: str) -> None:
        """Send it a line."""
        with suppress(OSError):  # it has ended; the launcher or the starter will end this process
            self.connection.sendall(f"{text}\n".encode())

    def listen(self) -> None:
        """Handle its messages: `lost RANK REASON`, or `heard` for each snapshot of the progress."""
        with suppress(OSError):  # nothing new, or it has ended
            self.buffer += self.connection.recv(1 << 16, socket.MSG_DONTWAIT)
        *lines, self.buffer = self.buffer.split(b"\n")
        for line in lines:
            word, _, rest = line.decode(errors="replace").partition(" ")
            if word == "lost":
                rank, _, reason = rest.partition(" ")
                self.lost[int(rank)] = reason
            else:
                self.unheard -= 1


def tell_command(text: str) -> None:
    """Send a line to the command, if one listens.

    loaded          this rank has loaded its program and looks for the others
    joined          it has found all of them
    sweeping        the cells are being computed, and a lost worker costs only its batch (rank 0)
    beat, pause     rank 0 is at work and beats every half second; it stops beating, and may be busy for long
    exit N SIGNAL   the program ends with exit code N, because of a signal or none (rank 0)

    and rank 0, with `tell_progress`:

    progress JSON   how far the run is, for the display
    """
    if (command := _command()) is not None:
        command.say(text)


def command_listens() -> bool:
    """Whether a command that listens started this process; it ends the remaining ranks after rank 0."""
    return _command() is not None


def tell_progress(text: str) -> None:
    """Send the progress to the command, unless it has not acknowledged earlier snapshots.

    Otherwise the socket of a stopped command would fill up, and the command would count as lost.
    """
    if (command := _command()) is None:
        return
    command.listen()
    if command.unheard < _MOST_UNHEARD:
        command.unheard += 1
        command.say(f"progress {text}")


def lost_according_to_command() -> dict[int, str]:
    """Ranks that their starters reported as lost, with reasons, each returned once; for rank 0."""
    if (command := _command()) is None:
        return {}
    command.listen()
    lost, command.lost = command.lost, {}
    return lost


@cache
def _command() -> _Command | None:
    """Command at the other end of the starter's connection; None if no starter started this process."""
    descriptor = os.environ.get(DESCRIPTOR_VARIABLE)
    return None if descriptor is None else _Command(socket.socket(fileno=int(descriptor)))
