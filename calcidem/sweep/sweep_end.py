"""End of a sweep: its state, exit code and errors."""

from dataclasses import dataclass, field
from enum import StrEnum

from calcidem.sweep.schedule import Tally

EXIT_COMPLETE = 0
"""All cells have outcomes."""

EXIT_ERROR = 1
"""Error that the same command would meet again."""

EXIT_RESUMABLE = 75
"""Stopped early with all finished cells stored; the same command continues (EX_TEMPFAIL of sysexits.h)."""


class SweepError(Exception):
    """Base class of errors of a whole sweep."""


class LaunchError(SweepError):
    """The program was started in a manner that does not allow the requested run."""


class WorkersLostError(SweepError):
    """A worker died or hung before all cells were computed; computed cells are stored."""


class SweepState(StrEnum):
    """Reason for the end of a sweep."""

    COMPLETE = "complete"
    """Every batch has a final outcome."""
    STOPPED = "stopped"
    """A signal requested it."""
    CUT_OFF = "cut off"
    """A worker died or hangs."""
    ERROR = "error"
    """An error of the master, most likely while storing."""


@dataclass(frozen=True, slots=True)
class SweepEnd:
    """End of a sweep."""

    state: SweepState
    """Reason for the end."""
    detail: str = ""
    """One sentence for the user; may be empty."""
    tally: Tally = field(default_factory=Tally)
    """Numbers of cells."""
    seconds: float = 0.0
    """Wall time of the sweep in s."""

    @property
    def exit_code(self) -> int:
        """Exit code: 0 complete, 75 stopped but resumable, 1 error."""
        return {SweepState.COMPLETE: EXIT_COMPLETE, SweepState.ERROR: EXIT_ERROR}.get(self.state, EXIT_RESUMABLE)
