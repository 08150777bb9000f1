import pytest

from calcidem.app.campaign.progress import _Forecast
from calcidem.ends import CellStatus
from calcidem.sweep.batch import Batch
from calcidem.sweep.outcome import BatchOutcome, Failure, Place

PLACE = Place(rank=2, host="node7")
BATCHES = [Batch(number, (number,), cost=1.0 + number, group=number) for number in range(3)]


def done(batch: Batch[int], seconds: float) -> BatchOutcome[int, int]:
    """Return the outcome of a batch that took so long."""
    return BatchOutcome(batch, PLACE, seconds, results=batch.cells)


def test_nothing_is_known_before_the_first_measurement() -> None:
    """Without a measured batch there is no time left to tell."""
    assert _Forecast(BATCHES).seconds_left(workers=1) is None


def test_unmeasured_groups_follow_their_estimates() -> None:
    """10 s for cost 1 make 20 s and 30 s for costs 2 and 3, so 50 s in all, or 25 s on two workers."""
    forecast = _Forecast(BATCHES)
    forecast.record(done(BATCHES[0], 10.0))
    assert forecast.seconds_left(workers=1) == pytest.approx(50.0)
    assert forecast.seconds_left(workers=2) == pytest.approx(25.0)


def test_measured_groups_follow_their_own_mean() -> None:
    """Two batches of one content that took 2 s and 4 s let the third take 3 s, whatever was estimated."""
    batches = [Batch(number, (number,), cost=100.0, group=5.0) for number in range(3)]
    forecast = _Forecast(batches)
    forecast.record(done(batches[0], 2.0))
    forecast.record(done(batches[1], 4.0))
    assert forecast.seconds_left(workers=1) == pytest.approx(3.0)
    assert (forecast.settled, forecast.total) == (2, 3)


def test_no_time_is_left_in_the_end() -> None:
    """Once all cells are settled, 0 s are left, even if none of them gave a measurement."""
    forecast = _Forecast(BATCHES)
    for batch in BATCHES:
        forecast.record(BatchOutcome(batch, PLACE, 1.0, failure=Failure(CellStatus.FAILED, "on order")))
    assert forecast.seconds_left(workers=1) == 0.0
