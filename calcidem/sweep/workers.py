"""The interface of a sweep to the processes that compute batches.

Three things do: ranks of MPI (`mpi_workers`), the processes of an executor (`executor_workers`), and this process.
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
    """Workers that are gone."""

    place: Place
    """Rank and host of the worker, or of the last one."""
    batch: Batch[CellT] | None
    """What it was computing, or None."""
    reason: str
    """How the loss was noticed."""
    seconds: float
    """Time that it had spent on the batch, s."""
    workers: int = 1
    """Number of workers that the batch took down, one after the other."""


class Workers(Protocol[CellT]):
    """Computes batches; used by one thread."""

    @property
    def count(self) -> int:
        """Number of workers, not counting lost ones."""

    @property
    def running(self) -> int:
        """Number of batches submitted that have no outcome yet and are not lost."""

    @property
    def wants_batch(self) -> bool:
        """Whether another batch may be submitted."""

    @property
    def exhausted(self) -> str:
        """Reason why nothing more can be computed; else empty."""

    def submit(self, batch: Batch[CellT], /) -> None:
        """Submit a batch."""

    def poll(self) -> tuple[list[BatchOutcome[CellT, Any]], list[Loss[CellT]]]:
        """Return the outcomes that have come and the workers found lost since the last call.

        A batch occurs in one of them, at most once.
        """

    def stop(self, end: SweepEnd, grace: float, /) -> frozenset[int]:
        """Drop what still runs within `grace` seconds; return the ranks that may still run."""


class SerialWorkers(Generic[CellT]):
    """The calling process as the only worker: each poll computes the submitted batch.

    The hard limit of a batch does not apply: the process that it would kill is the only one there is.
    ``interrupted`` is called every 0.1 to 0.5 s while a batch is computed: whether to drop it.
    """

    count = 1
    exhausted = ""

    def __init__(self, compute: Compute[CellT, Any], time_limit: float | None, interrupted: Callable[[], bool]) -> None:
        self._compute, self._time_limit, self._interrupted = compute, time_limit, interrupted
        self._batch: Batch[CellT] | None = None

    @property
    def running(self) -> int:
        """One from the submission of a batch to its outcome."""
        return int(self._batch is not None)

    @property
    def wants_batch(self) -> bool:
        """Whether there is no batch."""
        return self._batch is None

    def submit(self, batch: Batch[CellT]) -> None:
        """Take a batch for the next poll."""
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
