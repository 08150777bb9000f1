import itertools
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "docs" / "reproduction"))

from published_check import STAGES, growth_by_stage


def test_slopes_of_a_drawn_curve() -> None:
    """Means 0, 2, 1 at 1, 2, 3 % rise by 1/2 a percent from end to end and in least squares."""
    (growth,) = growth_by_stage([1, 2, 3], [0, 2, 1], {"I": (1, 3)})
    assert growth.end_point_slope == pytest.approx(0.5)
    assert growth.least_squares_slope == pytest.approx(0.5)


def test_the_two_slopes_differ_when_the_curve_bends() -> None:
    """Means 0, 0, 0, 4 rise by 4/3 from end to end, and by 1.2 in least squares."""
    (growth,) = growth_by_stage([0, 1, 2, 3], [0, 0, 0, 4], {"I": (0, 3)})
    assert growth.end_point_slope == pytest.approx(4 / 3)
    assert growth.least_squares_slope == pytest.approx(1.2)


def test_a_straight_line_has_the_same_rate_in_every_stage() -> None:
    """On a line of 200 m/s per percent, given in any order, every stage has that rate by both slopes."""
    contents = np.array([9.0, 0.11, 0.66, 1.24, 2.55, 3.17, 4.0, 6.0, 5.0, 7.0])
    for growth in growth_by_stage(contents, 150 + 200 * contents):
        assert growth.end_point_slope == pytest.approx(200)
        assert growth.least_squares_slope == pytest.approx(200)


def test_missing_contents_are_left_out() -> None:
    """A content whose mean is NaN does not count, and a stage with a single one left has no rate."""
    first, second, *_ = growth_by_stage([0.11, 0.34, 0.66, 1.24, 3.17], [210, 250, np.nan, 448, np.nan])
    assert first.contents == (0.11, 0.34)
    assert first.end_point_slope == pytest.approx(40 / 0.23)
    assert second.contents == (1.24,)
    assert np.isnan([second.end_point_slope, second.least_squares_slope]).all()


def test_stages_do_not_overlap() -> None:
    """Each stage begins above the end of the one before."""
    assert all(after[0] > before[1] for before, after in itertools.pairwise(STAGES.values()))
