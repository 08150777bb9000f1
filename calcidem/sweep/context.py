"""What rank 0 works with during a sweep, whether it has workers or computes itself."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol

from calcidem.sweep.batch import Batch, CellT
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import BatchOutcome
from calcidem.sweep.progress import Progress
from calcidem.sweep.schedule import Schedule
from calcidem.sweep.signals import StopRequest


class Sink(Protocol):
    """What the caller of a sweep gives to have its outcomes kept; used on rank 0 only, by one thread at a time.

    Where there are workers it is not the main thread, so that no worker waits for the disk (`GroupCommit`).

    An outcome is acknowledged once `store` has returned, so it must be on disk by then. A sweep that was
    killed may have stored a batch that it computes again later: storing twice must equal storing once.
    An exception of the sink ends the sweep and is passed on.
    """

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]], /) -> None:
        """Keep final outcomes, one or several."""

    def store_loss(self, batch: Batch[Any], reason: str, /) -> None:
        """Keep that a worker was lost over a batch; `batch.losses` counts this loss already.

        To be given back as `losses` when the same cells are planned again after a restart.
        """


@dataclass(frozen=True, slots=True)
class SweepContext(Generic[CellT]):
    """The parts of a sweep that rank 0 holds.

    Attributes
    ----------
    schedule
        Batches still to be handed out.
    sink, progress
        Where outcomes are stored, and shown.
    stop_request
        Signals noted so far.
    options
        Limits of a batch.
    """

    schedule: Schedule[CellT]
    sink: Sink
    progress: Progress
    stop_request: StopRequest
    options: SweepOptions

    def store(self, outcomes: list[BatchOutcome[CellT, Any]]) -> None:
        """Store final outcomes and show them."""
        if not outcomes:
            return
        self.sink.store(outcomes)
        for outcome in outcomes:
            self.progress.on_outcome(outcome)
