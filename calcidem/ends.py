"""Ends of a cell: one vocabulary for simulation, scheduler, store and displays, which do not import each other."""

from enum import StrEnum


class CellStatus(StrEnum):
    """Status of a cell; the values are stored."""

    PENDING = "pending"
    RUNNING = "running"
    """The first two are never stored: such a cell has no outcome."""
    DONE = "done"
    """It has a velocity."""
    NO_ARRIVAL = "no_arrival"
    """The simulation is right, but no velocity can be read from it."""
    UNSTABLE = "unstable"
    """A guard ended the simulation."""
    FAILED = "failed"
    """The computation raised an exception."""
    TIMED_OUT = "timed_out"
    """The computation reached the time limit of a batch."""
    QUARANTINED = "quarantined"
    """Workers were lost so often while computing the cell that it is not tried again."""

    @property
    def words(self) -> str:
        """The status as messages name it."""
        return self.value.replace("_", " ")
