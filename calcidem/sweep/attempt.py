"""One attempt at a batch: the same on a worker and in a serial run."""

import time
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.deadline import Deadline, TimeLimitReached
from calcidem.sweep.outcome import BatchOutcome, Failure, FailureKind, Place

ResultT = TypeVar("ResultT")
ResultT_co = TypeVar("ResultT_co", covariant=True)


class Compute(Protocol[CellT, ResultT_co]):
    """The computation of a batch, given by the caller of a sweep."""

    def __call__(self, batch: Batch[CellT], deadline_check: Callable[[], None], /) -> Sequence[ResultT_co]:
        """Return one picklable result for each cell, in the order of `batch.cells`.

        It must depend on the cells alone, not on rank, order or company in the batch: a batch may be
        computed again, in parts, elsewhere. `deadline_check` is to be called every 0.1 to 0.5 s and its
        exceptions passed on. Whatever else the computation raises becomes a failure of the batch.
        """


def attempt(
    batch: Batch[CellT], compute: Compute[CellT, ResultT], deadline: Deadline, place: Place
) -> BatchOutcome[CellT, ResultT]:
    """Compute a batch and return results or failure as data.

    Raises
    ------
    SweepInterrupted
        If the sweep has been told to end at once; the batch is dropped.
    """
    start = time.monotonic()
    try:
        results = tuple(compute(batch, deadline))
        return BatchOutcome(batch, place, time.monotonic() - start, results=results)
    except TimeLimitReached as error:
        failure = Failure(FailureKind.TIMED_OUT, str(error))
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it is, it costs only this batch
        failure = Failure.from_exception(FailureKind.FAILED, error)
    return BatchOutcome(batch, place, time.monotonic() - start, failure=failure)
