"""Correlation lengths against fields whose length is known, and their picture."""

import numpy as np
import pytest
import xarray as xr

from calcidem.analysis.figures.stiffness import draw_stiffness
from calcidem.analysis.random_field import correlation, field_statistics, scale_of_fluctuation


def test_averages_over_a_window_have_its_side_as_their_scale() -> None:
    """Uncorrelated values that are averaged over 6 steps along x and 3 along y have scales of 6 and 3 steps."""
    noise = np.random.default_rng(1).standard_normal((60, 62, 65))
    averaged = np.lib.stride_tricks.sliding_window_view(noise, (3, 6), axis=(1, 2)).mean(axis=(-2, -1))
    averaged[:, 5, 7] = np.nan
    for axis, side in ((-1, 6.0), (-2, 3.0)):
        assert scale_of_fluctuation(correlation(averaged, axis), 0.5) == pytest.approx(0.5 * side, rel=0.08)


def test_a_decaying_correlation_has_twice_its_length() -> None:
    """``r^k`` makes (1 + r) / (1 - r) steps; equal values have no correlation."""
    assert scale_of_fluctuation(0.8 ** np.arange(100), 1.0) == pytest.approx(9.0, rel=1e-6)
    assert np.isnan(scale_of_fluctuation(correlation(np.ones((2, 3, 4)), -1), 1.0))


def fields() -> xr.DataArray:
    """Log-normal fields of two contents, the second without values in one place."""
    logs = np.array([0.1, 0.5])[:, None, None, None] * np.random.default_rng(2).standard_normal((2, 20, 40, 30))
    values = 1e9 * np.exp(logs)
    values[1, 0, 0, 0] = np.nan
    places = {"content": [1.0, 5.0], "seed": np.arange(20), "y": 0.003 * np.arange(40), "x": 0.003 * np.arange(30)}
    return xr.DataArray(values, places, ("content", "seed", "y", "x"))


def test_statistics_are_those_of_the_log_normal_distribution() -> None:
    """Geometric mean and deviation of the logarithm; hardly any of it is between samples of uncorrelated values."""
    found = field_statistics(fields())
    np.testing.assert_allclose(found["log_deviation"], [0.1, 0.5], rtol=0.02)
    np.testing.assert_allclose(found["geometric_mean"], 1e9, rtol=0.02)
    np.testing.assert_allclose(found["scale_x"], 0.003, rtol=0.15)
    assert float(found["between"].max()) < 0.01
    assert found["unknown"].to_numpy() == pytest.approx([0.0, 1.0 / 24000.0])


def test_the_picture_shows_maps_scatter_and_length() -> None:
    """A map for each content, a bar of colours, and two panels against content."""
    described = field_statistics(fields()).assign(shear_modulus=fields()).assign_attrs(window=0.012)
    figure = draw_stiffness(described)
    titles = [axes.get_title(loc="left") for axes in figure.get_axes()]
    assert {"1 %", "5 %"} <= set(titles)
    assert {axes.get_ylabel() for axes in figure.get_axes()} >= {"sd of ln G", "scale of fluctuation (mm)"}
