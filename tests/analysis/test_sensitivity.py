"""Comparison of variants."""

import numpy as np
import pytest
import xarray as xr

from calcidem.analysis.distribution import paired_changes


def velocities(values: np.ndarray, contents: tuple[float, ...] = (5.0,)) -> xr.DataArray:
    """Matrix of Vs with the seeds 1, 2, ..."""
    seeds = np.arange(1, len(values) + 1)
    return xr.DataArray(
        values.reshape(len(values), -1), {"seed": seeds, "content": list(contents)}, ("seed", "content")
    )


def test_common_seeds_tell_a_scaled_copy_exactly() -> None:
    """A variant that doubles every deviation from the mean has a ratio of 2 whose interval has no width."""
    reference = np.random.default_rng(1).normal(1000.0, 50.0, 24)
    variant = reference.mean() + 2.0 * (reference - reference.mean())
    (change,) = paired_changes(velocities(variant), velocities(reference))
    assert change.deviation_ratio == pytest.approx(2.0)
    assert change.deviation_ratio_interval.half_width < 1e-9
    assert change.mean_ratio == pytest.approx(1.0)


def test_unread_cells_are_left_out_on_both_sides() -> None:
    """A seed without velocity in the variant does not count in the reference either."""
    reference = np.random.default_rng(2).normal(1000.0, 50.0, 24)
    variant = 1.1 * reference
    variant[3] = np.nan
    (change,) = paired_changes(velocities(variant), velocities(reference))
    assert (change.measured, change.planned) == (23, 24)
    assert change.mean_ratio == pytest.approx(1.1)
    own = variant[np.isfinite(variant)]
    assert (change.mean, change.standard_deviation) == pytest.approx((np.mean(own), np.std(own, ddof=1)))
    assert change.deviation_ratio == pytest.approx(1.1)


@pytest.mark.parametrize(("seeds", "compared"), [(3, False), (4, True)])
def test_four_common_seeds_have_a_ratio(seeds: int, compared: bool) -> None:
    """Fewer have none, however many each side has."""
    generator = np.random.default_rng(4)
    variant, reference = generator.normal(1000.0, 50.0, (2, 8))
    variant[seeds:] = np.nan
    (change,) = paired_changes(velocities(variant), velocities(reference))
    assert change.measured == seeds
    assert [np.isfinite(ratio) for ratio in (change.mean_ratio, change.deviation_ratio)] == [compared] * 2


def test_interval_covers_the_true_ratio_of_independent_samples() -> None:
    """Of 40 pairs of independent samples with a true ratio of 1.5, most intervals hold it."""
    generator = np.random.default_rng(3)
    held = 0
    for _ in range(40):
        pair = generator.normal(0.0, 1.0, (2, 40)) * [[1.5], [1.0]] + 100.0
        (change,) = paired_changes(velocities(pair[0]), velocities(pair[1]))
        held += change.deviation_ratio_interval.contains(1.5)
    assert held >= 33


@pytest.mark.parametrize("seeds", [7, 8, 12])
def test_a_reference_without_scatter_has_no_ratio_of_scatter(seeds: int) -> None:
    """Without cement all samples are one; rounding of their mean is no scatter."""
    (change,) = paired_changes(velocities(np.full(seeds, 210.1)), velocities(np.full(seeds, 199.3)))
    assert change.standard_deviation == 0.0
    assert change.mean_ratio == pytest.approx(210.1 / 199.3)
    assert np.isnan([change.deviation_ratio, change.deviation_ratio_interval.low]).all()
