"""Statistics that only the pages of reproduction use."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "docs" / "reproduction"))

from shapes import jarque_bera_power
from variance import variance_parts


def test_variance_parts_recover_what_a_table_was_made_of() -> None:
    """Rows of sd 3, columns of sd 10 and a rest of sd 5 come back from a large table, and sum up."""
    generator = np.random.default_rng(4)
    table = (
        500.0
        + generator.normal(0.0, 3.0, (200, 1))
        + generator.normal(0.0, 10.0, (1, 200))
        + generator.normal(0.0, 5.0, (200, 200))
    )
    parts = variance_parts(table)
    assert parts.deviations == pytest.approx((3.0, 10.0, 5.0), rel=0.15)
    assert parts.total == pytest.approx(sum(d**2 for d in parts.deviations))


def test_an_additive_table_has_no_rest() -> None:
    """If each value is its row's part plus its column's, nothing is left over."""
    table = np.add.outer([1.0, 4.0, 2.0], [10.0, 30.0, 80.0, 20.0])
    parts = variance_parts(table)
    assert parts.rest == pytest.approx(0.0, abs=1e-9)
    assert parts.first == pytest.approx(np.var([1.0, 4.0, 2.0], ddof=1))
    assert parts.second == pytest.approx(np.var([10.0, 30.0, 80.0, 20.0], ddof=1))


def test_gaps_and_small_tables_are_refused() -> None:
    """A variance cannot be divided with a value missing or with one row."""
    with pytest.raises(ValueError, match="complete table"):
        variance_parts(np.array([[1.0, np.nan], [2.0, 3.0]]))
    with pytest.raises(ValueError, match="complete table"):
        variance_parts(np.array([[1.0, 2.0]]))


def test_power_is_the_share_of_skewed_samples_that_are_found() -> None:
    """Of 116 values with a skewness of 0.5 the test finds about 38 %, of 1,000 nearly all; of normal ones 5 %."""
    # Standard errors of 2,000 samples are 0.011 and 0.005.
    assert jarque_bera_power(116, 0.5, samples=2000) == pytest.approx(0.385, abs=0.035)
    assert jarque_bera_power(116, 0.0, samples=2000) == pytest.approx(0.047, abs=0.015)
    assert jarque_bera_power(1000, 0.5, samples=300) > 0.99
