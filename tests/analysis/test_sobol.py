"""Sobol indices against closed forms, and what is made of campaigns with gaps."""

import math

import numpy as np
import pytest
import xarray as xr

from calcidem.analysis.figures import style
from calcidem.analysis.figures.sensitivity import draw_sobol
from calcidem.analysis.sensitivity import campaign_outputs, sobol_indices, sobol_points

RANGES = dict.fromkeys(("first", "second", "third"), (-math.pi, math.pi))
A, B = 7.0, 0.1


def ishigami(x: np.ndarray) -> np.ndarray:
    """Function of Ishigami & Homma (1990), doi:10.1109/ISUMA.1990.151285, at points along the first axis."""
    return np.asarray(np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0]))


def expected_indices() -> tuple[list[float], list[float]]:
    """First and total indices of the Ishigami function in closed form."""
    first = 0.5 * (1 + B * math.pi**4 / 5) ** 2
    second = A**2 / 8
    both = B**2 * math.pi**8 * 8 / 225
    variance = first + second + both
    return [first / variance, second / variance, 0.0], [
        (first + both) / variance,
        second / variance,
        both / variance,
    ]


def test_the_ishigami_function_has_its_indices() -> None:
    """From 1,024 base points first and total indices are within 0.02 of the closed form, and within their intervals."""
    found = sobol_indices(RANGES, ishigami(sobol_points(RANGES, 1024)))
    for name, expected in zip(("first", "total"), expected_indices(), strict=True):
        error = np.abs(found[name].to_numpy() - expected)
        assert (error < 0.02).all()
        assert (error <= 1.5 * found[f"{name}_half_width"].to_numpy() + 1e-12).all()
    assert int(found["bases"]) == 1024


def test_base_points_with_gaps_are_left_out() -> None:
    """Outputs that are missing cost their base points and nothing else."""
    output = ishigami(sobol_points(RANGES, 1024))
    output[[0, 3, 777]] = np.nan  # the first two are of one base point, which has five
    found = sobol_indices(RANGES, output)
    assert int(found["bases"]) == 1022
    np.testing.assert_allclose(found["total"], expected_indices()[1], atol=0.03)


def test_an_output_that_does_not_vary_has_no_indices() -> None:
    """A share of 1 everywhere has no variance to divide, and of three base points nothing can be said."""
    assert bool(sobol_indices(RANGES, np.ones(5 * 16))["total"].isnull().all())
    output = ishigami(sobol_points(RANGES, 16))
    output[15:] = np.nan
    assert bool(sobol_indices(RANGES, output)["first"].isnull().all())


def test_outputs_of_samples_with_gaps() -> None:
    """Mean and deviation are over what is read, the share over all; one velocity has no mean to compare."""
    vs = np.array([[100.0, 200.0, 300.0, np.nan], [150.0, np.nan, np.nan, np.nan]])
    found = campaign_outputs(vs)
    np.testing.assert_allclose(found["mean"], [200.0, np.nan])
    np.testing.assert_allclose(found["relative_deviation"], [0.5, np.nan])
    np.testing.assert_allclose(found["readable_share"], [0.75, 0.25])


def test_numbers_of_base_points_that_are_no_powers_of_two_are_refused() -> None:
    """The sequence is even only then."""
    for bases in (0, 2, 12):
        with pytest.raises(ValueError, match=f"bases = {bases}: give a power of two"):
            sobol_points(RANGES, bases)


def test_the_figure_has_a_panel_for_each_output_and_content() -> None:
    """Indices of two contents are drawn, those that do not exist as words."""
    one = sobol_indices(RANGES, ishigami(sobol_points(RANGES, 16)))
    none = sobol_indices(RANGES, np.ones(5 * 16))
    contents = [
        xr.concat([a, b], dim="content").assign_coords(content=[0.66, 5.0]) for a, b in ((one, one), (none, one))
    ]
    outputs = ["mean", "relative_deviation", "readable_share"]
    indices = xr.concat([contents[0], contents[0], contents[1]], dim="output").assign_coords(output=outputs)
    figure = draw_sobol(indices)
    assert len(figure.axes) == 6
    assert style.render(figure, "png").startswith(b"\x89PNG")
