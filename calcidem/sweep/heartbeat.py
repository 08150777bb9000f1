"""Signs of life of rank 0 for the program that started the launcher: MPI itself does not notice a stopped process."""

import os
import platform
import time
from pathlib import Path

from calcidem.sweep.session import EXIT_CODE_FILE_VARIABLE

HEARTBEAT_SUFFIX = ".alive"
"""Ends the name of the file whose time of change is the sign; the file is there only while signs are to be expected."""


class Heartbeat:
    """A file beside the one of the exit code; without that there is nobody to give signs to."""

    def __init__(self) -> None:
        beside = os.environ.get(EXIT_CODE_FILE_VARIABLE)
        self._path = Path(beside + HEARTBEAT_SUFFIX) if beside else None
        self._begun = False

    def beat(self) -> None:
        """Give a sign, the first one with host and process."""
        if self._path is None:
            return
        if self._begun:
            os.utime(self._path)
        else:
            self._path.write_text(f"process {os.getpid()} on {platform.node()}\n", encoding="ascii")
            self._begun = True

    def end(self) -> None:
        """Give none any more."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


class HeartbeatMonitor:
    """Hears the signs of life.

    Parameters
    ----------
    exit_code_file
        The file of the exit code, as named to the ranks.
    """

    def __init__(self, exit_code_file: Path) -> None:
        self._path = Path(f"{exit_code_file}{HEARTBEAT_SUFFIX}")
        self._last = 0
        self._heard = time.monotonic()
        self.who = ""

    def silence(self) -> float:
        """Seconds since the last sign that was heard; 0 while none are to be expected.

        The clock is one that stands still while the machine sleeps.
        """
        try:
            sign, self.who = self._path.stat().st_mtime_ns, self._path.read_text(encoding="ascii").strip()
        except FileNotFoundError:
            sign = 0
        if sign != self._last or sign == 0:
            self._last, self._heard = sign, time.monotonic()
            return 0.0
        return time.monotonic() - self._heard
