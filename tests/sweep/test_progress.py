import io

import pytest
from rich.console import Console

from calcidem.sweep import (
    BarProgress,
    Batch,
    BatchOutcome,
    Failure,
    FailureKind,
    LineProgress,
    Place,
    Progress,
    SweepEnd,
    SweepState,
    progress_for,
)
from calcidem.sweep.forecast import Forecast
from calcidem.sweep.progress import duration

PLACE = Place(rank=2, host="node7")
BATCHES = [Batch(number, (number,), cost=1.0 + number, group=number) for number in range(3)]


def done(batch: Batch[int], seconds: float) -> BatchOutcome[int, int]:
    """Return the outcome of a batch that took so long."""
    return BatchOutcome(batch, PLACE, seconds, results=batch.cells)


def test_nothing_is_known_before_the_first_measurement() -> None:
    """Without a measured batch there is no time left to tell."""
    assert Forecast(BATCHES).seconds_left(workers=1) is None


def test_unmeasured_groups_follow_their_estimates() -> None:
    """10 s for cost 1 make 20 s and 30 s for costs 2 and 3, so 50 s in all, or 25 s on two workers."""
    forecast = Forecast(BATCHES)
    forecast.record(done(BATCHES[0], 10.0))
    assert forecast.seconds_left(workers=1) == pytest.approx(50.0)
    assert forecast.seconds_left(workers=2) == pytest.approx(25.0)


def test_measured_groups_follow_their_own_mean() -> None:
    """Two batches of one content that took 2 s and 4 s let the third take 3 s, whatever was estimated."""
    batches = [Batch(number, (number,), cost=100.0, group=5.0) for number in range(3)]
    forecast = Forecast(batches)
    forecast.record(done(batches[0], 2.0))
    forecast.record(done(batches[1], 4.0))
    assert forecast.seconds_left(workers=1) == pytest.approx(3.0)
    assert (forecast.settled, forecast.total) == (2, 3)


def test_no_time_is_left_in_the_end() -> None:
    """Once all cells are settled, 0 s are left, even if none of them gave a measurement."""
    forecast = Forecast(BATCHES)
    for batch in BATCHES:
        forecast.record(BatchOutcome(batch, PLACE, 1.0, failure=Failure(FailureKind.FAILED, "on order")))
    assert forecast.seconds_left(workers=1) == 0.0


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "?"),
        (0.4, "0 s"),
        (99.0, "99 s"),
        (300.0, "5 min"),
        (3 * 3600.0 + 120.0, "3 h 02 min"),
        (50 * 3600.0, "2 d 2 h"),
    ],
)
def test_durations_read_well(seconds: float | None, text: str) -> None:
    """A duration is given in the two largest units that matter."""
    assert duration(seconds) == text


def tell_a_story(progress: Progress) -> None:
    """Let a display live through a sweep with a failure and a lost worker."""
    progress.on_start(BATCHES, workers=2)
    progress.on_outcome(done(BATCHES[0], 10.0))
    failure = Failure(FailureKind.FAILED, "ZeroDivisionError: on order")
    progress.on_outcome(BatchOutcome(BATCHES[1], PLACE, 1.0, failure=failure))
    progress.on_loss(PLACE, "its process ended")
    progress.on_heartbeat(workers=1, running=1)
    progress.on_end(SweepEnd(SweepState.STOPPED, "SIGUSR1: running batches were finished"))


def test_lines_tell_what_matters() -> None:
    """In a log there are lines for the start, a failure, a loss, the time left and the end, without colours."""
    stream = io.StringIO()
    tell_a_story(LineProgress(Console(file=stream, width=60), shortest=0.0))
    text = stream.getvalue()
    assert "3 cells in 3 batches on 2 workers" in text
    assert "failed: 1 on rank 2 (node7): ZeroDivisionError: on order" in text
    assert "lost rank 2 (node7): its process ended" in text
    assert "2 of 3 cells (67%), 30 s left, 1 worker\n" in text
    assert "stopped after 0 s, 0 cells settled, SIGUSR1: running batches were finished" in text
    assert "\x1b" not in text


def test_the_bar_shows_count_and_time_left() -> None:
    """On a terminal the bar has the number of cells and the time left."""
    stream = io.StringIO()
    tell_a_story(BarProgress(Console(file=stream, force_terminal=True, width=120)))
    text = stream.getvalue()
    assert "2/3" in text
    assert "30 s left" in text
    assert "lost rank 2" in text


def test_the_display_suits_the_console() -> None:
    """A terminal gets a bar, anything else gets lines."""
    assert isinstance(progress_for(Console(file=io.StringIO())), LineProgress)
    assert isinstance(progress_for(Console(file=io.StringIO(), force_terminal=True)), BarProgress)
