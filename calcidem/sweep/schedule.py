"""Batches of cells, decisions about the next one and about each outcome, and an attempt at one, in any process.

Also what a sweep shows and how it ends: progress, states, exit codes and errors, a time limit, or signals. Nothing here
communicates.
"""

import os
import signal
import time
import traceback
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum
from functools import partial
from types import FrameType
from typing import Any, Generic, Protocol, Self, TypeAlias, TypeVar

from calcidem.ends import CellStatus

LOSSES_BEFORE_QUARANTINE = 3
"""Number of times that a run died while a cell was computed, after which the cell is not tried again."""


EXIT_COMPLETE = 0
"""All cells have outcomes."""


EXIT_ERROR = 1
"""Error that the same command meets again as long as its cause remains."""


EXIT_RESUMABLE = 75
"""Stopped early with all finished cells stored; the same command continues (EX_TEMPFAIL of sysexits.h)."""


CellT = TypeVar("CellT", bound=Hashable)

Cell: TypeAlias = tuple[int, float]
"""(seed, content in percent of the sand's mass) of a campaign's cell."""


@dataclass(frozen=True, slots=True)
class Batch(Generic[CellT]):
    """Cells that one worker computes together."""

    cells: tuple[CellT, ...]
    """At least one cell, each hashable and picklable."""
    cost: float = 1.0
    """Expected effort in any unit, larger than zero; only ratios matter. A worker may be silent in proportion to it."""
    losses: int = 0
    """Number of earlier runs that died while these cells were computed."""

    @property
    def is_alone(self) -> bool:
        """Whether no other batch may be computed meanwhile, so that another death has only one possible cause."""
        return self.losses > 1


def plan_batches(
    pending: Iterable[Cell],
    lanes: int,
    cost_of_content: Callable[[float], float],
    losses: Mapping[Cell, int] | None = None,
) -> tuple[Batch[Cell], ...]:
    """Group the pending cells into batches, in the order of computation.

    All cells of a batch have the same content. The batches form rounds, one for every `lanes` seeds: whole seeds are
    complete early, so a stopped campaign is usable. Within a round the expensive contents come first, so that no long
    batch remains at the end. Cells that were computed when a run died come last, and after a second death each for
    itself, so that they affect few others.

    Parameters
    ----------
    pending
        Cells to compute, (seed, content), in any order; duplicates count once.
    lanes
        Largest number of cells in a batch.
    cost_of_content
        Expected effort of one batch of the given content, in any unit.
    losses
        Number of earlier runs that died while each cell was computed; zero for cells not named.

    Returns
    -------
    tuple of Batch
        In the order in which they should be handed out.
    """
    losses = losses or {}
    cells = sorted(set(pending))
    groups: dict[tuple[float, int], list[Cell]] = defaultdict(list)
    for cell in cells:
        groups[cell[1], losses.get(cell, 0)].append(cell)  # by seed, as the cells are
    round_of_seed = {seed: rank // lanes for rank, seed in enumerate(sorted({seed for seed, _ in cells}))}
    batches = []
    for (content, lost), group in groups.items():
        cost, width = cost_of_content(content), 1 if lost > 1 else lanes
        batches += [Batch(tuple(group[start : start + width]), cost, lost) for start in range(0, len(group), width)]
    # The first seed of a batch determines its round, since this seed has waited longest.
    batches.sort(key=lambda batch: (batch.losses, round_of_seed[batch.cells[0][0]], -batch.cost, batch.cells[0]))
    return tuple(batches)


ResultT = TypeVar("ResultT")


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
        Unless there is one result for each cell.
    """

    batch: Batch[CellT]
    seconds: float
    """Wall time of the computation in s."""
    results: tuple[ResultT, ...] | None = None
    """One result for each cell in the order of `batch.cells`; None with a failure."""
    failure: Failure | None = None
    """Reason for missing results; None with results."""
    rank: int = 0
    host: str = ""
    """Number of the rank that computed it, and name of its machine."""

    def __post_init__(self) -> None:
        """Count the results, which the caller of a sweep computes."""
        if self.results is not None and len(self.results) != len(self.batch.cells):
            given = f"{len(self.results)} results for {len(self.batch.cells)} cells"
            raise ValueError(f"{given}; return exactly one result for each cell")


@dataclass
class Schedule(Generic[CellT]):
    """Batches still to be handed out.

    Rules, the same for every executor:

    - Batches are handed out in the order given.
    - A batch of several cells that raised an exception is split, and its cells are computed next, one by one, so that
      only the bad cell fails. A batch that timed out is not split: its cells advance side by side, so each alone would
      take about as long.
    - A batch that took down its workers is split, too, and nothing is computed beside any of its cells: what happened
      to be on the same worker is not blamed.
    """

    batches: Sequence[Batch[CellT]]
    """Batches in the order of computation."""
    tally: Counter[CellStatus] = field(default_factory=Counter)
    """Cells with a final outcome by what they ended with; all that have a result count as done."""

    def __post_init__(self) -> None:
        """Queue the batches."""
        self._queue: deque[Batch[CellT]] = deque(self.batches)

    def __len__(self) -> int:
        """Return the number of waiting batches."""
        return len(self._queue)

    def extend(self, batches: Iterable[Batch[CellT]]) -> None:
        """Queue batches after the others, new ones or ones not begun."""
        self._queue.extend(batches)

    def take(self, beside: int = 0) -> Batch[CellT] | None:
        """Remove and return the next batch; None without one, or if it may not be computed beside so many others."""
        if not self._queue or (beside and self._queue[0].is_alone):
            return None
        return self._queue.popleft()

    def settle(self, outcome: BatchOutcome[CellT, ResultT]) -> BatchOutcome[CellT, ResultT] | None:
        """Return an outcome if it is final, None if its cells are computed again."""
        batch = outcome.batch
        kind = CellStatus.DONE if outcome.failure is None else outcome.failure.kind
        is_deadly = kind is CellStatus.QUARANTINED and not batch.is_alone
        if is_deadly or (kind is CellStatus.FAILED and len(batch.cells) > 1):
            losses = 2 if is_deadly else batch.losses  # which is alone
            # With the cost of all: the cells fill SIMD lanes, so one takes about as long as the whole batch.
            self._queue.extendleft(replace(batch, cells=(cell,), losses=losses) for cell in reversed(batch.cells))
            return None
        self.tally[kind] += len(batch.cells)
        return outcome


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
    """A signal requested it, of this process or of a worker."""
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
    tally: Counter[CellStatus] = field(default_factory=Counter)
    """See `Schedule`."""
    seconds: float = 0.0
    """Wall time of the sweep in s."""

    @property
    def exit_code(self) -> int:
        """Exit code: 0 complete, 75 stopped but resumable, 1 error."""
        return {SweepState.COMPLETE: EXIT_COMPLETE, SweepState.ERROR: EXIT_ERROR}.get(self.state, EXIT_RESUMABLE)


class Progress:
    """Receiver of the progress of a sweep, on rank 0 only; this base class shows nothing."""

    def on_start(self, batches: Sequence[Batch[Any]], workers: int) -> None:
        """Receive the batches of the sweep and the number of workers, before the first is handed out."""

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Receive a stored outcome."""

    def on_heartbeat(self) -> None:
        """Called twice a second during the sweep."""

    def on_end(self, end: SweepEnd) -> None:
        """Receive the end of the sweep."""


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

    Attributes
    ----------
    has_lost
        Asked at a SIGTERM: whether it came since another rank has died; by default it did not.
    end_at_once
        Ends all; by default this process.
    level
        Urgency of a requested end.
    reason
        Name of the signal that requested it, empty if none.
    """

    def __init__(self, *, finishes: bool = True) -> None:
        # mpirun forwards SIGUSR2 to its ranks and waits for them, while on SIGTERM it kills them a quarter of a second
        # later. So a launcher that passes its own SIGTERM on as SIGUSR2 gets an orderly end.
        wanted = {"SIGUSR1": self._drain if finishes else lambda *_: None} | dict.fromkeys(
            ("SIGTERM", "SIGINT", "SIGHUP", "SIGUSR2"), self._hurry
        )
        self._handlers: dict[signal.Signals, Any] = {
            getattr(signal, name): handler for name, handler in wanted.items() if hasattr(signal, name)
        }
        self.has_lost: Callable[[], bool] = lambda: False
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
