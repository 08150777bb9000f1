"""Ends of a cell: one vocabulary for simulation, scheduler, store and displays, which do not import each other."""

from enum import StrEnum


class CellStatus(StrEnum):
    """Status of a cell; the values are stored."""

    PENDING = "pending"
    """It has no outcome yet; this is never stored."""
    RUNNING = "running"
    """The same, while it is computed: an attempt has begun."""
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
    """Three runs died while it was computed, so it is not tried again."""

    @property
    def words(self) -> str:
        """The status as messages name it."""
        return self.value.replace("_", " ")
