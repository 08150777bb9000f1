"""How a sweep ends: its state, the exit code that says so, and the errors that end it."""

from dataclasses import dataclass, field
from enum import StrEnum

from calcidem.sweep.schedule import Tally

EXIT_COMPLETE = 0
"""Everything requested is settled."""

EXIT_ERROR = 1
"""Something went wrong that the same command would meet again."""

EXIT_RESUMABLE = 75
"""Stopped early, all that was finished is stored, the same command continues (EX_TEMPFAIL of sysexits.h)."""


class SweepError(Exception):
    """Base class of what can go wrong with a sweep as a whole."""


class LaunchError(SweepError):
    """The program was started in a manner in which it cannot work as requested."""


class MasterLostError(SweepError):
    """Rank 0 has died; a worker alone can do nothing more."""


class WorkersLostError(SweepError):
    """The workers are lost before all was computed; what was is stored."""


class SweepState(StrEnum):
    """Why a sweep ended."""

    COMPLETE = "complete"
    """Every batch is settled."""
    STOPPED = "stopped"
    """A signal requested it."""
    OUT_OF_WORKERS = "out of workers"
    """All workers are lost, or one is and the MPI library cannot continue without it."""
    ERROR = "error"
    """The master met an error, most likely while storing."""


@dataclass(frozen=True, slots=True)
class SweepEnd:
    """How a sweep ended, the same on all ranks."""

    state: SweepState
    """Why it ended."""
    detail: str = ""
    """One sentence for a person, or an empty text."""
    tally: Tally = field(default_factory=Tally)
    """Numbers of cells and lost workers."""
    seconds: float = 0.0
    """Wall time of the sweep in s."""
    unresponsive_ranks: frozenset[int] = frozenset()
    """Ranks that may still run but did not answer the request to stop; known on rank 0 only."""

    @property
    def exit_code(self) -> int:
        """The exit code that says so: 0 complete, 75 stopped but resumable, 1 error."""
        return {SweepState.COMPLETE: EXIT_COMPLETE, SweepState.ERROR: EXIT_ERROR}.get(self.state, EXIT_RESUMABLE)
