"""Messages of a rank to the command that started it, over the connection of its starter."""

import os
import socket
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache

from calcidem.launch.starter import DESCRIPTOR_VARIABLE

_MOST_UNHEARD = 4
"""Snapshots of the progress that the command has not acknowledged; a busy or stopped command gets no more."""


@dataclass(slots=True)
class _Command:
    """The command that listens to this process."""

    connection: socket.socket
    """To it; the starter writes in the same end."""
    buffer: bytes = b""
    """What has come in of its next line."""
    lost: dict[int, str] = field(default_factory=dict)
    """Ranks that it has reported as lost and that were not read yet, with reasons."""
    unheard: int = 0
    """Number of snapshots of the progress that it has not acknowledged yet."""

    def say(self, text: str) -> None:
        """Send it a line."""
        with suppress(OSError):  # it is gone; the launcher or the starter will end this process
            self.connection.sendall(f"{text}\n".encode())

    def listen(self) -> None:
        """Handle its messages: `lost RANK REASON`, or `heard` for each snapshot of the progress."""
        with suppress(OSError):  # nothing new, or it is gone
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
    """Whether this process was started by a command that listens, and ends what is left when rank 0 has ended."""
    return _command() is not None


def tell_progress(text: str) -> None:
    """Send the progress to the command, unless it has not received the snapshot before: nothing waits for a display.

    Otherwise the socket of a stopped command would fill up, and it would count as lost.
    """
    if (command := _command()) is None:
        return
    command.listen()
    if command.unheard < _MOST_UNHEARD:
        command.unheard += 1
        command.say(f"progress {text}")


def lost_according_to_command() -> dict[int, str]:
    """Ranks that their starters reported to the command as lost, with reasons, each returned once; for rank 0."""
    if (command := _command()) is None:
        return {}
    command.listen()
    lost, command.lost = command.lost, {}
    return lost


@cache
def _command() -> _Command | None:
    """The command at the other end of the starter's connection; None if no starter started this process."""
    descriptor = os.environ.get(DESCRIPTOR_VARIABLE)
    return None if descriptor is None else _Command(socket.socket(fileno=int(descriptor)))
