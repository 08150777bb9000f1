"""Correlation lengths against fields whose length is known, and their picture."""

import numpy as np
import pytest
import xarray as xr

from calcidem.analysis.figures.stiffness import draw_stiffness
from calcidem.analysis.random_field import _autocorrelation, _scale_of_fluctuation, describe_fields


def test_averages_over_a_window_have_its_side_as_their_scale() -> None:
    """Uncorrelated values that are averaged over 6 steps along x and 3 along y have scales of 6 and 3 steps."""
    noise = np.random.default_rng(1).standard_normal((60, 62, 65))
    averaged = np.lib.stride_tricks.sliding_window_view(noise, (3, 6), axis=(1, 2)).mean(axis=(-2, -1))
    averaged[:, 5, 7] = np.nan
    for axis, side in ((-1, 6.0), (-2, 3.0)):
        assert _scale_of_fluctuation(_autocorrelation(averaged, axis), 0.5) == pytest.approx(0.5 * side, rel=0.08)


def test_a_decaying_correlation_has_twice_its_length() -> None:
    """``r^k`` makes (1 + r) / (1 - r) steps, a line its first zero; equal values have no correlation."""
    assert _scale_of_fluctuation(1.0 - np.arange(9) / 2.5, 2.0) == pytest.approx(5.0, rel=1e-12)
    assert _scale_of_fluctuation(0.8 ** np.arange(100), 1.0) == pytest.approx(9.0, rel=1e-6)
    assert np.isnan(_scale_of_fluctuation(_autocorrelation(np.ones((2, 3, 4)), -1), 1.0))


def described() -> xr.Dataset:
    """Log-normal fields of two contents, the second without a value in one place, and without its last sample."""
    x, y = 0.003 * np.arange(30), 0.003 * np.arange(40)
    logs = np.array([0.1, 0.5])[:, None, None, None] * np.random.default_rng(2).standard_normal((2, 20, 40, 30))
    values = 1e9 * np.exp(logs)
    values[1, 0, 0, 0] = np.nan
    cells = [(seed, content) for seed in range(20) for content in (1.0, 5.0)][:-1]
    found = {(seed, content): (x, y, values[int(content > 1.0), seed]) for seed, content in cells}
    return describe_fields(found).assign_attrs(window=0.012)


def test_statistics_are_those_of_the_log_normal_distribution() -> None:
    """Geometric mean and deviation of the logarithm; hardly any of it is between samples of uncorrelated values."""
    found = described()
    assert dict(found.sizes) == {"content": 2, "seed": 20, "y": 40, "x": 30}
    np.testing.assert_allclose(found["log_deviation"], [0.1, 0.5], rtol=0.02)
    np.testing.assert_allclose(found["geometric_mean"], 1e9, rtol=0.02)
    np.testing.assert_allclose(found["scale_x"], 0.003, rtol=0.15)
    assert float(found["between"].max()) < 0.01
    assert found["unknown"].to_numpy() == pytest.approx([0.0, 1.0 / 22800.0])


def test_equal_stiffnesses_have_no_share_between_samples() -> None:
    """Without cement all samples of a lattice are alike: the deviation is zero, and of nothing there is no share."""
    places = 0.003 * np.arange(4)
    found = describe_fields({(seed, 0.0): (places, places, np.full((4, 4), 1e9)) for seed in range(3)})
    assert float(found["log_deviation"][0]) == 0.0
    assert bool(found["between"].isnull().all())


def test_each_axis_has_its_own_scale() -> None:
    """Averages over 6 steps of 0.5 along x and 3 of 0.25 along y have scales of 3 and 0.75."""
    noise = np.random.default_rng(3).standard_normal((60, 62, 65))
    averaged = np.lib.stride_tricks.sliding_window_view(noise, (3, 6), axis=(1, 2)).mean(axis=(-2, -1))
    x, y = 0.5 * np.arange(averaged.shape[2]), 0.25 * np.arange(averaged.shape[1])
    found = describe_fields({(seed, 1.0): (x, y, np.exp(field)) for seed, field in enumerate(averaged)})
    assert found["scale_x"].item() == pytest.approx(3.0, rel=0.08)
    assert found["scale_y"].item() == pytest.approx(0.75, rel=0.08)


def test_the_picture_shows_maps_scatter_and_length() -> None:
    """A map for each content, a bar of colours, and two panels against content."""
    axes = draw_stiffness(described()).get_axes()
    titles = {panel.get_title(loc=place) for panel in axes for place in ("left", "center")}
    assert {"1 %", "5 %"} <= titles
    assert {panel.get_ylabel() for panel in axes} >= {"sd of ln G", "scale of fluctuation (mm)"}
