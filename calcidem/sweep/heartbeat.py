"""Heartbeat of rank 0 for the program that started the launcher: MPI itself does not notice a stopped process."""

import os
import platform
import time
from pathlib import Path

from calcidem.sweep.session import EXIT_CODE_FILE_VARIABLE

_HEARTBEAT_SUFFIX = ".heartbeat"
"""Ends the name of the file whose time of change is the heartbeat; it is there only while beats are to be expected."""


class Heartbeat:
    """Rank 0's end: a file beside the one of the exit code; without that there is nobody to beat for."""

    def __init__(self) -> None:
        beside = os.environ.get(EXIT_CODE_FILE_VARIABLE)
        self._path = Path(beside + _HEARTBEAT_SUFFIX) if beside else None
        self._begun = False

    def beat(self) -> None:
        """Beat once, the first time with host and process."""
        if self._path is None:
            return
        if self._begun:
            os.utime(self._path)
        else:
            self._path.write_text(f"process {os.getpid()} on {platform.node()}\n", encoding="ascii")
            self._begun = True

    def end(self) -> None:
        """Let nobody expect any more beats."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


class HeartbeatMonitor:
    """The end of the program that started the launcher.

    Parameters
    ----------
    exit_code_file
        The file of the exit code, as named to the ranks.

    Attributes
    ----------
    sender
        Process and host of rank 0, once it has beaten.
    """

    def __init__(self, exit_code_file: Path) -> None:
        self._path = Path(f"{exit_code_file}{_HEARTBEAT_SUFFIX}")
        self._last = 0
        self._changed = time.monotonic()
        self.sender = ""

    def seconds_since_last(self) -> float:
        """Seconds since the last beat that was seen; 0 while none are to be expected.

        The clock is one that stands still while the machine sleeps.
        """
        try:
            beat, self.sender = self._path.stat().st_mtime_ns, self._path.read_text(encoding="ascii").strip()
        except FileNotFoundError:
            beat = 0
        if beat != self._last or beat == 0:
            self._last, self._changed = beat, time.monotonic()
            return 0.0
        return time.monotonic() - self._changed
