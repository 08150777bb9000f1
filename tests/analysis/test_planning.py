import numpy as np
import pytest
from numpy.typing import NDArray

from calcidem.analysis.distribution import narrowing
from calcidem.analysis.intervals import Interval, next_seed_count


def test_half_widths_of_normal_values_are_the_known_ones() -> None:
    """For 400 normal values, deviation and skewness scatter by s / sqrt(2 n) and sqrt(6 / n)."""
    values = np.random.default_rng(3).normal(1000, 100, 5000)
    found = narrowing(values, [400])
    assert float(found["mean"][0]) == pytest.approx(1.966 * 100 / 20, rel=0.05)
    assert float(found["standard_deviation"][0]) == pytest.approx(1.96 * 100 / np.sqrt(800), rel=0.1)
    assert float(found["skewness"][0]) == pytest.approx(1.96 * np.sqrt(6 / 400), rel=0.1)


@pytest.mark.parametrize("count", [4, 8, 40])
def test_the_forecast_for_a_deviation_is_the_interval_that_comes(count: int) -> None:
    """Fresh samples of so many values have intervals as wide in the mean, within a tenth."""
    generator = np.random.default_rng(5)
    forecast = float(narrowing(generator.normal(1000, 100, 400), [count])["standard_deviation"][0])
    come = [Interval.of_standard_deviation(row).half_width for row in generator.normal(1000, 100, (400, count))]
    assert forecast == pytest.approx(np.mean(come), rel=0.1)


def test_four_times_the_seeds_halve_every_half_width() -> None:
    """From 100 to 400 seeds every interval becomes half as wide, within a tenth."""
    found = narrowing(np.random.default_rng(4).normal(1000, 100, 500), [100, 400])
    for name in ("mean", "standard_deviation", "skewness"):
        assert float(found[name][0] / found[name][1]) == pytest.approx(2.0, rel=0.1)


def test_values_without_scatter_have_no_error() -> None:
    """Equal values have half-widths of zero and no skewness."""
    found = narrowing(np.full(10, 5.0), [3, 20])
    assert (found["mean"] == 0).all()
    assert (found["standard_deviation"] == 0).all()
    assert np.isnan(found["skewness"]).all()


def test_impossible_plans_are_refused() -> None:
    """A single value and counts below three are refused."""
    with pytest.raises(ValueError, match="at least two"):
        narrowing([1.0, float("nan")], [4])
    with pytest.raises(ValueError, match="at least 3 seeds"):
        narrowing([1.0, 2.0, 3.0], [2, 5])


def seeds_until(values: NDArray[np.float64], begin: int, *, mean: float | None = None, sd: float | None = None) -> int:
    """Number of seeds with which a content ends whose seeds have these values."""
    count = begin
    while (found := next_seed_count(values[:count], len(values), mean=mean, sd=sd)) > count:
        count = found
    return count


def test_seeds_are_added_until_the_intervals_are_narrow() -> None:
    """The intervals of the last number suffice, it is little above the smallest, and there is a limit."""
    values = np.random.default_rng(1).normal(1000, 100, 2000)
    count = seeds_until(values, 8, mean=0.02, sd=0.1)
    used = values[:count]
    assert Interval.of_mean(used).half_width <= 0.02 * used.mean()
    assert Interval.of_standard_deviation(used).half_width <= 0.1 * used.std(ddof=1)
    assert 150 < count < 280  # 0.1 needs 196 of a normal distribution
    assert seeds_until(values[:64], 8, mean=0.001) == 64
    assert next_seed_count(values[:100], 50, mean=0.001) == 100


def test_equal_values_are_known_at_once() -> None:
    """Without scatter, as without cement, there is nothing to narrow."""
    assert next_seed_count(np.full(8, 169.73), 100, mean=0.02, sd=0.1) == 8


def test_a_content_that_is_hardly_read_gets_no_more_seeds() -> None:
    """Fewer than half of the seeds say little about all, however many there are; one half is enough."""
    values = np.random.default_rng(1).normal(1000, 500, 16)
    values[:9] = np.nan
    assert next_seed_count(values, 100, mean=0.02) == 16
    values[0] = 900.0
    assert next_seed_count(values, 100, mean=0.02) == 32


@pytest.mark.full
@pytest.mark.parametrize(("scatter", "begin"), [(0.05, 8), (0.1, 8), (0.1, 16), (0.25, 16)])
@pytest.mark.parametrize("is_normal", [True, False])
def test_what_ends_when_it_is_narrow_still_holds_the_truth(scatter: float, begin: int, is_normal: bool) -> None:
    """Looking again and again costs the intervals two percent of their cover at most, of 1500 campaigns each."""
    draws, hits = np.random.default_rng(5), 0
    spread = np.sqrt(np.log1p(scatter**2))
    for _ in range(1500):
        normal = draws.standard_normal(1000)
        values = 1.0 + scatter * normal if is_normal else np.exp(spread * normal - spread**2 / 2)
        hits += Interval.of_mean(values[: seeds_until(values, begin, mean=0.02)]).contains(1.0)
    assert 0.92 < hits / 1500 < 0.97


def test_the_next_number_of_seeds_follows_from_the_square_of_the_excess() -> None:
    """An interval 1.3 times too wide needs 1.69 times as many seeds, in batches of 8, and at most twice as many."""
    values = np.random.default_rng(2).normal(100.0, 10.0, size=64)
    relative = Interval.of_mean(values).half_width / values.mean()
    assert next_seed_count(values, 1000, mean=relative / 1.3) == 112
    assert next_seed_count(values, 1000, mean=relative / 3.0) == 128
    assert next_seed_count(values, 1000, mean=relative * 1.01) == 64
