"""One attempt at a batch, in any process that computes, within a time limit."""

import time
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from typing import Protocol, TypeVar

from calcidem.ends import CellStatus
from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.outcome import BatchOutcome, Failure, Place, ResultT

ResultT_co = TypeVar("ResultT_co", covariant=True)

IS_INTERRUPTED: ContextVar[Callable[[], bool]] = ContextVar("is_interrupted", default=lambda: False)
"""Whether this process has to drop the batch that it computes; asked every 0.1 to 0.5 s."""


class _TimeLimitReached(Exception):  # noqa: N818 - an expected end of a computation, not an error of the program
    """The batch has exceeded its time limit; becomes the failure `timed_out`."""


class SweepInterrupted(BaseException):
    """The sweep ends now and drops the batch; not an Exception, so that no computation catches it."""


class Deadline:
    """Check that a computation calls every 0.1 to 0.5 s, between chunks of compiled work.

    Python signal handlers and timers cannot interrupt compiled code, so the computation has to call this check. The
    limit is in seconds from now, None for none.
    """

    def __init__(self, time_limit: float | None) -> None:
        self._time_limit = time_limit
        self._start = time.monotonic()

    def __call__(self) -> None:
        """Return if time is left.

        `_TimeLimitReached` if the batch has used up its time; `SweepInterrupted` if the sweep has to end at once.
        """
        if IS_INTERRUPTED.get()():
            raise SweepInterrupted
        elapsed = time.monotonic() - self._start
        if self._time_limit is not None and elapsed > self._time_limit:
            raise _TimeLimitReached(
                f"not finished after {elapsed:.1f} s; the time limit of a batch is {self._time_limit:g} s"
            )


class Compute(Protocol[CellT, ResultT_co]):
    """Computation of a batch, given by the caller of a sweep."""

    def __call__(self, batch: Batch[CellT], deadline_check: Callable[[], None], /) -> Sequence[ResultT_co]:
        """Return one picklable result for each cell, in the order of `batch.cells`.

        A result must depend only on its cell, not on rank, order or the other cells of the batch, since a batch may be
        computed again elsewhere or in parts. The computation calls `deadline_check` every 0.1 to 0.5 s and does not
        catch its exceptions. Any other exception becomes a failure of the batch.
        """


def attempt(
    batch: Batch[CellT], compute: Compute[CellT, ResultT], time_limit: float | None, place: Place
) -> BatchOutcome[CellT, ResultT]:
    """Compute a batch; return its results or its failure as data.

    `SweepInterrupted` if the sweep has to end at once; the batch is dropped.
    """
    start = time.monotonic()
    try:
        results = tuple(compute(batch, Deadline(time_limit)))
        return BatchOutcome(batch, place, time.monotonic() - start, results=results)
    except _TimeLimitReached as error:
        failure = Failure(CellStatus.TIMED_OUT, str(error))
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it is, it costs only this batch
        failure = Failure.from_exception(CellStatus.FAILED, error)
    return BatchOutcome(batch, place, time.monotonic() - start, failure=failure)
