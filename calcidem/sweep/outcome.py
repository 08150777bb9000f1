"""Outcome of a batch: results, or a failure as data."""

import platform
import traceback
from dataclasses import dataclass
from typing import Generic, Self, TypeVar

from calcidem.ends import CellStatus
from calcidem.sweep.batch import Batch, CellT

ResultT = TypeVar("ResultT")


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a computation."""

    rank: int
    host: str
    """Number of the rank and name of its machine."""

    @classmethod
    def here(cls, rank: int) -> Self:
        """Return the place of this process, which has the given rank."""
        return cls(rank=rank, host=platform.node())


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure of a batch."""

    kind: CellStatus
    """What the cells of the batch end with: failed, timed out or quarantined."""
    message: str
    """One sentence for the user."""
    traceback: str = ""
    """Python traceback of the exception; may be empty."""

    @classmethod
    def from_exception(cls, kind: CellStatus, error: BaseException) -> Self:
        """Return an exception as data, since it might not be picklable itself."""
        return cls(
            kind=kind,
            message=f"{type(error).__name__}: {error}",
            traceback="".join(traceback.format_exception(error)),
        )


@dataclass(frozen=True, slots=True)
class BatchOutcome(Generic[CellT, ResultT]):
    """Outcome of a batch.

    Raises
    ------
    ValueError
        Unless exactly one of `results` and `failure` is given, with one result for each cell.
    """

    batch: Batch[CellT]
    place: Place
    """Rank and host that computed it."""
    seconds: float
    """Wall time of the computation in s."""
    results: tuple[ResultT, ...] | None = None
    """One result for each cell in the order of `batch.cells`, or None."""
    failure: Failure | None = None
    """Reason for missing results, or None."""

    def __post_init__(self) -> None:
        """Check that exactly one of both is given."""
        if (self.results is None) == (self.failure is None):
            raise ValueError(f"batch {self.batch.identifier}: give either results or failure")
        if self.results is not None and len(self.results) != len(self.batch.cells):
            raise ValueError(
                f"batch {self.batch.identifier}: {len(self.results)} results for {len(self.batch.cells)}"
                " cells; return exactly one result for each cell"
            )
