"""What rank 0 works with during a sweep, whether it has workers or computes itself."""

from dataclasses import dataclass
from typing import Any, Generic

from calcidem.sweep.batch import CellT
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.outcome import BatchOutcome
from calcidem.sweep.progress import Progress
from calcidem.sweep.schedule import Schedule
from calcidem.sweep.signals import StopRequest
from calcidem.sweep.sink import Sink


@dataclass(frozen=True, slots=True)
class SweepContext(Generic[CellT]):
    """The parts of a sweep that rank 0 holds."""

    schedule: Schedule[CellT]
    sink: Sink
    progress: Progress
    stop_request: StopRequest
    options: SweepOptions

    def store(self, outcomes: list[BatchOutcome[CellT, Any]]) -> None:
        """Store final outcomes together, so that a fast sweep pays for few transactions, and tell of them."""
        if not outcomes:
            return
        self.sink.store(outcomes)
        for outcome in outcomes:
            self.progress.settled(outcome)
