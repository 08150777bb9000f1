"""Interface of a sweep to the processes that compute batches.

These are MPI ranks (`mpi_workers`), the processes of an executor (`executor_workers`), or this process.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol

from calcidem.sweep.attempt import Compute, Deadline, SweepInterrupted, attempt
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.outcome import BatchOutcome, Place
from calcidem.sweep.sweep_end import SweepEnd


@dataclass(frozen=True, slots=True)
class Loss(Generic[CellT]):
    """Loss of one or several workers."""

    place: Place
    """Rank and host of the last worker."""
    batch: Batch[CellT] | None
    """Batch that it was computing, or None."""
    reason: str
    """Evidence for the loss."""
    seconds: float
    """Time spent on the batch, s."""
    workers: int = 1
    """Number of workers lost while computing the batch, one after the other."""


class Workers(Protocol[CellT]):
    """Computes batches; used by one thread."""

    @property
    def count(self) -> int:
        """Number of workers, not counting lost ones."""

    @property
    def running(self) -> int:
        """Number of submitted batches without an outcome that are not lost."""

    @property
    def wants_batch(self) -> bool:
        """Whether another batch may be submitted."""

    @property
    def exhausted(self) -> str:
        """Reason why no more batches can be computed; else empty."""

    def submit(self, batch: Batch[CellT], /) -> None:
        """Submit a batch."""

    def poll(self) -> tuple[list[BatchOutcome[CellT, Any]], list[Loss[CellT]]]:
        """Return new outcomes and lost workers since the last call.

        A batch occurs in one of both, at most once.
        """

    def stop(self, end: SweepEnd, grace: float, /) -> frozenset[int]:
        """Drop running batches within `grace` seconds; return the ranks that may still be running."""


class SerialWorkers(Generic[CellT]):
    """Calling process as the only worker: each poll computes the submitted batch.

    The hard limit of a batch does not apply, since it would kill the only process. ``interrupted`` is called every 0.1
    to 0.5 s during a batch and returns whether to drop it.
    """

    count = 1
    exhausted = ""

    def __init__(self, compute: Compute[CellT, Any], time_limit: float | None, interrupted: Callable[[], bool]) -> None:
        self._compute, self._time_limit, self._interrupted = compute, time_limit, interrupted
        self._batch: Batch[CellT] | None = None

    @property
    def running(self) -> int:
        """One between submission and outcome of a batch, else zero."""
        return int(self._batch is not None)

    @property
    def wants_batch(self) -> bool:
        """Whether no batch is submitted."""
        return self._batch is None

    def submit(self, batch: Batch[CellT]) -> None:
        """Keep a batch for the next poll."""
        self._batch = batch

    def poll(self) -> tuple[list[BatchOutcome[CellT, Any]], list[Loss[CellT]]]:
        """Compute the batch, unless it is interrupted."""
        if self._batch is None or self._interrupted():
            return [], []
        try:
            deadline = Deadline(self._time_limit, self._interrupted)
            outcome = attempt(self._batch, self._compute, deadline, Place.here(rank=0))
        except SweepInterrupted:
            return [], []
        self._batch = None
        return [outcome], []

    def stop(self, _end: SweepEnd, _grace: float) -> frozenset[int]:
        """Do nothing: between polls nothing runs."""
        return frozenset()
