"""Campaigns beside one another: differences have the intervals of printed tests."""

import math

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from calcidem.analysis.comparison import _correlation, compare_velocities
from calcidem.analysis.intervals import Interval


def velocities(values: object, contents: tuple[float, ...] = (2.0,), first_seed: int = 1) -> xr.DataArray:
    """Give velocities along (seed, content)."""
    matrix = np.array(values, dtype=float).reshape(-1, len(contents))
    seeds = np.arange(first_seed, first_seed + len(matrix))
    return xr.DataArray(matrix, {"seed": seeds, "content": list(contents)}, ("seed", "content"))


def test_difference_of_means_is_scipys_welch() -> None:
    """The interval of two samples of unequal variance is that of SciPy's Welch test; equal values have no width."""
    one, other = np.random.default_rng(3).normal((500.0,), 30.0, 9), np.array([420.0, 470.0, 610.0, 380.0])
    expected = stats.ttest_ind(one, other, equal_var=False).confidence_interval(0.9)
    found = Interval.of_difference(one, other, 0.9)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    assert Interval.of_difference(np.full(3, 200.0), np.full(2, 190.0)) == Interval(10.0, 10.0)
    assert math.isnan(Interval.of_difference(one, other[:1]).low)


def test_pairs_are_the_seeds_that_both_have() -> None:
    """Seeds without a velocity in one of two campaigns make no pair; what the others share falls out."""
    first = velocities([300.0, 420.0, 510.0, np.nan, 700.0])
    other = velocities([431.0, 519.0, 650.0, np.nan, 800.0], first_seed=2)  # seeds 2 to 6; 4 and 5 are not pairs
    found = compare_velocities({"a": first, "b": other}).sel(campaign="b", content=2.0)
    assert int(found["pairs"]) == 2
    assert float(found["paired_difference"]) == pytest.approx(10.0)  # of 431 - 420 and 519 - 510
    expected = stats.ttest_rel([431.0, 519.0], [420.0, 510.0]).confidence_interval(0.95)
    assert found["paired_difference_interval"].values == pytest.approx([expected.low, expected.high])
    assert float(found["difference"]) == pytest.approx(600.0 - 482.5)
    assert (int(found["n"]), math.isnan(found["pair_correlation"])) == (4, True)
    many = velocities([300.0, 420.0, 510.0, 480.0, 700.0])
    twice = compare_velocities({"a": many, "b": 2.0 * many}).sel(campaign="b", content=2.0)
    assert float(twice["deviation_ratio"]) == pytest.approx(2.0)
    assert twice["deviation_ratio_interval"].values == pytest.approx([2.0, 2.0])  # every draw of seeds has it
    assert float(twice["pair_correlation"]) == pytest.approx(1.0)


def test_equal_pairs_correlate_and_a_constant_column_does_not() -> None:
    """A campaign that gives the velocities of another has a correlation of 1 with it."""
    values = np.array([300.0, 420.0, 510.0, 480.0, 700.0])
    assert _correlation(np.column_stack([values, values])) == pytest.approx(1.0)
    assert math.isnan(_correlation(np.column_stack([values, np.full(5, 500.0)])))


def test_contents_of_one_campaign_alone_have_no_difference() -> None:
    """A content that the first campaign lacks is described and not compared, nor is the first with itself."""
    first, other = velocities([[1.0], [2.0]]), velocities([[3.0, 5.0], [4.0, 6.0]], (2.0, 3.0))
    found = compare_velocities({"a": first, "b": other})
    assert found["n"].values.tolist() == [[2, 0], [2, 2]]
    assert np.isfinite(found["difference"].values).tolist() == [[False, False], [True, False]]
    assert np.isnan(found["mean"].values).tolist() == [[False, True], [False, False]]
    with pytest.raises(ValueError, match="1 campaigns are given"):
        compare_velocities({"a": first})


@pytest.mark.full
def test_the_paired_interval_is_the_narrower_one_of_pairs_that_go_together_and_covers_95_percent() -> None:
    """Of 2000 simulated pairs of campaigns both intervals hold the true difference in 95 %; paired ones are shorter."""
    random = np.random.default_rng(7)
    held, width = np.zeros(2), np.zeros(2)
    for _ in range(2000):
        common = random.normal(500.0, 50.0, 12)
        first, other = common + random.normal(0.0, 10.0, 12), common + 20.0 + random.normal(0.0, 10.0, 12)
        found = compare_velocities({"a": velocities(first), "b": velocities(other)}).isel(campaign=1, content=0)
        bounds = np.array([found[f"{name}_interval"].values for name in ("difference", "paired_difference")])
        held += (bounds[:, 0] <= 20.0) & (bounds[:, 1] >= 20.0)
        width += bounds[:, 1] - bounds[:, 0]
    assert held[1] / 2000 == pytest.approx(0.95, abs=0.02)  # four standard errors
    assert held[0] > held[1]  # what both share makes Welch's too wide
    assert width[1] < 0.4 * width[0]
