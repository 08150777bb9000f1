"""The errors of the velocities of some cells in a few numbers."""

import numpy as np
import pytest

from calcidem.analysis.velocity import are_samples, error_budget

CELLS = {
    "content": np.full(4, 5.0),
    "vs": np.array([100.0, 200.0, 300.0, np.nan]),
    "reading_error": np.array([0.03, 0.04, np.nan, np.nan]),
    "numerical_error": np.array([0.004, 0.003, 0.001, np.nan]),
    "pulse_effect": np.array([0.02, 0.021, np.nan, 0.5]),
    "vs_error": np.array([0.0303, 0.0401, np.nan, np.nan]),
}


def test_budget_sums_up_the_cells_that_have_errors() -> None:
    """Medians are of samples with all errors; scatter by readings and effects of the pulse of those that have them."""
    budget = error_budget(CELLS)
    assert (budget.reading, budget.numerical, budget.total) == pytest.approx((0.035, 0.0035, 0.0352))
    assert budget.scatter == pytest.approx(np.sqrt((3.0**2 + 8.0**2) / 2))
    assert budget.loud == 1  # an effect of 2 % is allowed, and a cell without a velocity has none
    assert str(budget) == "3.5 % (median; reading 3.5 %, simulation 0.35 %, pulse 2.1 %)"


def test_one_sample_of_many_seeds_counts_once() -> None:
    """Without cement all seeds are one sample: one velocity, no scatter by readings, one that depends on the pulse."""
    same = {name: values[[1, 1, 1]] for name, values in CELLS.items()} | {"content": 0.0}
    budget = error_budget(same)
    assert np.isnan(budget.scatter)
    assert (budget.reading, budget.loud) == (pytest.approx(0.04), 1)
    assert are_samples([[np.nan, 1.0], [2.0, 3.0], [4.0, np.nan]], [0.0, 5.0]).tolist() == [
        *([False, True], [True, True], [False, False])
    ]


def test_no_part_exceeds_its_whole() -> None:
    """Medians of whole and parts are over the same samples, even if most of these lack one part."""
    generator = np.random.default_rng(1)
    parts = generator.uniform(0.0, 0.1, (3, 200))
    parts[1, 20:] = np.nan  # the readings of these are worse
    parts[0, 20:] += 1.0
    names = ("reading_error", "numerical_error", "pulse_effect")
    cells = dict(zip(names, parts, strict=True)) | {"vs": np.full(200, 300.0), "content": 5.0}
    budget = error_budget(cells | {"vs_error": np.sqrt(np.sum(parts**2, axis=0))})
    assert budget.total >= max(budget.reading, budget.numerical, budget.pulse)


def test_a_budget_without_errors_is_unknown() -> None:
    """Cells of an old campaign have no error of the reading, and the text says so instead of showing a part."""
    old = {name: values[2:] for name, values in CELLS.items()}
    assert str(error_budget(old)).startswith("unknown")
