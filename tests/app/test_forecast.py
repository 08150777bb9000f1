"""The time left of a run: from the expected costs of cells, and the seconds that some of them took."""

from types import SimpleNamespace

import pytest

from calcidem.app.campaign.progress import ProgressDisplay, ProgressReporter, RunProgress
from calcidem.sweep.batch import Batch, Cell
from calcidem.sweep.outcome import BatchOutcome, Failure, FailureKind, Place

PLACE = Place(rank=2, host="node7")
BATCHES = [Batch(number, ((1, float(number)),), cost=1.0 + number) for number in range(3)]


class Shown(ProgressDisplay):
    """Keeps the last snapshot."""

    last: RunProgress

    def show(self, progress: RunProgress) -> None:
        """Keep it."""
        self.last = progress


def seconds_left(batches: list[Batch[Cell]], seconds: list[float], workers: int = 1) -> float | None:
    """Tell a reporter of batches and how long the first of them took, and return what it tells of the time left."""
    shown = Shown()
    reporter = ProgressReporter(shown)
    reporter.on_start(batches, workers)
    for batch, took in zip(batches, seconds, strict=False):
        reporter.on_outcome(BatchOutcome(batch, PLACE, took, results=[SimpleNamespace(status="done")]))
    reporter._tell_cells(workers, workers, at_once=True)
    assert (shown.last.finished, shown.last.total) == (len(seconds), len(batches))
    return shown.last.seconds_left


def test_nothing_is_known_before_the_first_measurement() -> None:
    """Without a measured batch there is no time left to tell."""
    assert seconds_left(BATCHES, []) is None


def test_cells_that_are_left_follow_their_expected_costs() -> None:
    """10 s for cost 1 make 20 s and 30 s for costs 2 and 3, so 50 s in all, or 25 s on two workers."""
    assert seconds_left(BATCHES, [10.0]) == pytest.approx(50.0)
    assert seconds_left(BATCHES, [10.0], workers=2) == pytest.approx(25.0)


def test_the_seconds_of_all_results_count() -> None:
    """Two batches of one content that took 2 s and 4 s let the third take 3 s, whatever was estimated."""
    batches = [Batch(number, ((number, 5.0),), cost=100.0) for number in range(3)]
    assert seconds_left(batches, [2.0, 4.0]) == pytest.approx(3.0)


def test_no_time_is_left_in_the_end() -> None:
    """Once all cells are settled, 0 s are left, even if none of them gave a measurement."""
    shown = Shown()
    reporter = ProgressReporter(shown)
    reporter.on_start(BATCHES, 1)
    for batch in BATCHES:
        reporter.on_outcome(BatchOutcome(batch, PLACE, 1.0, failure=Failure(FailureKind.FAILED, "on order")))
    reporter._tell_cells(1, 0, at_once=True)
    assert shown.last.seconds_left == 0.0
