"""One attempt at a batch, in any process that computes, and what ends it early: a time limit, or signals."""

import os
import signal
import time
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from enum import IntEnum
from functools import partial
from types import FrameType
from typing import Any, Protocol, Self, TypeVar

from calcidem.ends import CellStatus
from calcidem.sweep.schedule import EXIT_RESUMABLE, Batch, BatchOutcome, CellT, Failure, ResultT

ResultT_co = TypeVar("ResultT_co", covariant=True)

IS_INTERRUPTED: ContextVar[Callable[[], bool]] = ContextVar("is_interrupted", default=lambda: False)
"""Whether this process has to drop the batch that it computes; asked every 0.1 to 0.5 s."""


class _TimeLimitReached(Exception):  # noqa: N818 - an expected end of a computation, not an error of the program
    """The batch has exceeded its time limit; becomes the failure `timed_out`."""


class SweepInterrupted(BaseException):
    """The sweep ends now and drops the batch; not an Exception, so that no computation catches it."""


class Compute(Protocol[CellT, ResultT_co]):
    """Computation of a batch, given by the caller of a sweep."""

    def __call__(self, batch: Batch[CellT], raise_if_stopped: Callable[[], None], /) -> Sequence[ResultT_co]:
        """Return one picklable result for each cell, in the order of `batch.cells`.

        A result must depend only on its cell, not on rank, order or the other cells of the batch, since a batch may be
        computed again elsewhere or in parts. The computation calls `raise_if_stopped` every 0.1 to 0.5 s and does not
        catch its exceptions. Any other exception becomes a failure of the batch.
        """


def attempt(
    batch: Batch[CellT], compute: Compute[CellT, ResultT], time_limit: float | None
) -> BatchOutcome[CellT, ResultT]:
    """Compute a batch; return its results or its failure as data.

    The time limit is in seconds from now, None for none. `SweepInterrupted` if the sweep has to end at once; the batch
    is dropped.
    """
    start = time.monotonic()

    def raise_if_stopped() -> None:
        # The computation calls it, since signal handlers and timers of Python cannot interrupt compiled code.
        if IS_INTERRUPTED.get()():
            raise SweepInterrupted
        elapsed = time.monotonic() - start
        if time_limit is not None and elapsed > time_limit:
            raise _TimeLimitReached(
                f"not finished after {elapsed:.1f} s; the time limit of a batch is {time_limit:g} s"
            )

    try:
        results = tuple(compute(batch, raise_if_stopped))
        return BatchOutcome(batch, time.monotonic() - start, results=results)
    except _TimeLimitReached as error:
        failure = Failure(CellStatus.TIMED_OUT, str(error))
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it is, it costs only this batch
        failure = Failure.from_exception(CellStatus.FAILED, error)
    return BatchOutcome(batch, time.monotonic() - start, failure=failure)


class StopLevel(IntEnum):
    """Urgency of a requested end."""

    NONE = 0
    DRAIN = 1
    """Finish the running batches, store them, then stop."""
    HURRY = 2
    """Store finished batches and stop now."""
    LOST = 3
    """The same, since a rank has died and its launcher ends the others."""


class StopRequest:
    """Context manager that turns signals into a level of urgency to be polled; for the main thread only.

    Signals that this system lacks are left out, and those that are ignored stay so, as `nohup` and a shell's `&`
    require. The former handlers are restored.

    A second urgent signal calls `end_at_once`, unless it comes within a second of the first: a batch system and mpirun
    may both forward the same request.

    Parameters
    ----------
    finishes
        Whether SIGUSR1 is a request; the ranks that compute ignore it and finish their batches.
    has_lost
        Asked at a SIGTERM: whether it came since another rank has died.

    Attributes
    ----------
    has_lost
        As the parameter.
    end_at_once
        Ends all; by default this process.
    level
        Urgency of a requested end.
    reason
        Name of the signal that requested it, empty if none.
    """

    def __init__(self, *, finishes: bool = True, has_lost: Callable[[], bool] = lambda: False) -> None:
        # mpirun forwards SIGUSR2 to its ranks and waits for them, while on SIGTERM it kills them a quarter of a second
        # later. So a launcher that passes its own SIGTERM on as SIGUSR2 gets an orderly end.
        wanted = {"SIGUSR1": self._drain if finishes else lambda *_: None} | dict.fromkeys(
            ("SIGTERM", "SIGINT", "SIGHUP", "SIGUSR2"), self._hurry
        )
        self._handlers: dict[signal.Signals, Any] = {
            getattr(signal, name): handler for name, handler in wanted.items() if hasattr(signal, name)
        }
        self.has_lost = has_lost
        self.end_at_once: Callable[[], object] = partial(os._exit, EXIT_RESUMABLE)
        self._hurry_since: float | None = None
        self.level = StopLevel.NONE
        self.reason = ""

    def __enter__(self) -> Self:
        """Install the handlers."""
        self._handlers = {
            number: handler
            for number, handler in self._handlers.items()
            if signal.getsignal(number) is not signal.SIG_IGN
        }
        self._swap()
        return self

    def __exit__(self, *exception: object) -> None:
        """Restore the former handlers."""
        self._swap()

    @property
    def explanation(self) -> str:
        """Reason in words for the user; SIGUSR2 stands for another signal of the user."""
        if self.level is StopLevel.LOST:
            return "a rank died, and its launcher ended the others"
        return "SIGTERM or Ctrl-C, passed on as SIGUSR2" if self.reason == "SIGUSR2" else self.reason

    def hurry(self) -> bool:
        """Whether the running batches have to be dropped."""
        return self.level >= StopLevel.HURRY

    def raise_if_stopped(self) -> None:
        """Raise `SweepInterrupted` if what runs has to be dropped."""
        if self.hurry():
            raise SweepInterrupted

    def _swap(self) -> None:
        self._handlers = {number: signal.signal(number, handler) for number, handler in self._handlers.items()}

    def _drain(self, number: int, _frame: FrameType | None) -> None:
        if self.level is StopLevel.NONE:
            self.level, self.reason = StopLevel.DRAIN, signal.Signals(number).name

    def _hurry(self, number: int, _frame: FrameType | None) -> None:
        now, name = time.monotonic(), signal.Signals(number).name
        if self._hurry_since is None:
            self._hurry_since = now
            is_loss = name == "SIGTERM" and self.has_lost()
            self.level, self.reason = StopLevel.LOST if is_loss else StopLevel.HURRY, name
        elif now - self._hurry_since > 1.0:
            self.end_at_once()
