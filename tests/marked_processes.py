"""Processes that a test has started, and those that they have started, found by what stands in their environment."""

import os
import signal
import time
from contextlib import suppress
from pathlib import Path


class MarkedProcesses:
    """What starts processes with the variable `MARK` set to its folder, and wants them gone within `GRACE` seconds."""

    MARK: str
    GRACE = 3.0
    folder: Path

    def environment(self) -> dict[str, str]:
        """Mark of the processes, and a folder of their own for temporary files.

        A killed mpirun leaves /tmp/ompi.PID, and Open MPI 5.0 refuses to start where it finds one of its own number.
        """
        temporary = self.folder.with_name(f"{self.folder.name}.tmp")
        temporary.mkdir(exist_ok=True)
        return {self.MARK: str(self.folder), "TMPDIR": str(temporary)}

    def processes(self, *variables: str) -> list[int]:
        """Processes that still run, or those of them that have variables set like this, ``NAME=value``."""
        marks = {variable.encode() for variable in (f"{self.MARK}={self.folder}", *variables)}
        found = []
        for path in Path("/proc").glob("[0-9]*/environ"):
            try:
                if marks <= set(path.read_bytes().split(b"\0")):
                    found.append(int(path.parent.name))
            except OSError:
                continue  # it has ended meanwhile, or is not ours
        return found

    def leaves_no_process(self, grace: float | None = None) -> bool:
        """Whether all processes are gone in time; the kernel needs a moment to kill them."""
        end = time.monotonic() + (self.GRACE if grace is None else grace)
        while self.processes():
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    def kill_all(self) -> None:
        """Kill whatever still runs."""
        for process in self.processes():
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
