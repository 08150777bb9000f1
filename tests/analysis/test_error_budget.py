"""The errors of the velocities of some cells in a few numbers."""

import numpy as np
import pytest

from calcidem.analysis.error_budget import error_budget

CELLS = {
    "vs": np.array([100.0, 200.0, 300.0, np.nan]),
    "reading_error": np.array([0.03, 0.04, np.nan, np.nan]),
    "numerical_error": np.array([0.004, 0.003, 0.001, np.nan]),
    "pulse_effect": np.array([0.02, 0.021, np.nan, 0.5]),
    "vs_error": np.array([0.0303, 0.0401, np.nan, np.nan]),
}


def test_budget_sums_up_the_cells_that_have_errors() -> None:
    """Medians, scatter by readings and velocities that depend on the pulse are those of cells with the numbers."""
    budget = error_budget(CELLS)
    assert (budget.reading, budget.numerical, budget.total) == pytest.approx((0.035, 0.003, 0.0352))
    assert budget.scatter == pytest.approx(np.sqrt((3.0**2 + 8.0**2) / 2))
    assert budget.loud == 1  # an effect of 2 % is allowed, and a cell without a velocity has none
    assert str(budget) == "3.5 % (median; reading 3.5 %, simulation 0.3 %, pulse 2.1 %)"


def test_one_sample_read_for_many_seeds_has_no_scatter_by_readings() -> None:
    """Without cement all seeds are one sample: its reading error is no part of a standard deviation of zero."""
    same = {name: values[[0, 0, 0]] for name, values in CELLS.items()}
    assert np.isnan(error_budget(same).scatter)
    assert error_budget(same).reading == pytest.approx(0.03)


def test_a_budget_without_errors_is_unknown() -> None:
    """Cells of an old campaign have no error of the reading, and the text says so instead of showing a part."""
    old = {name: values[2:] for name, values in CELLS.items()}
    assert str(error_budget(old)).startswith("unknown")
