"""Peaks of signals, and where they are between samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import find_peaks

from calcidem.dem.engine.portable import find_maxima, parabola_vertex


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("levels", [0, 4])
def test_maxima_are_those_of_scipy_to_the_last_bit(smooth: bool, levels: int) -> None:
    """Peaks, level ones too, are those that SciPy finds in random signals of any length."""
    generator = np.random.default_rng(7)
    for size in (1, 2, 3, 40, 300):
        signal = generator.normal(size=size)
        signal = np.cumsum(signal) if smooth else signal
        signal = np.round(signal * levels) if levels else signal
        peaks = find_maxima(signal)
        assert peaks.tolist() == find_peaks(signal)[0].tolist()


@given(st.floats(-0.5, 0.5), st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
def test_the_vertex_of_a_parabola_is_exact(place: float, height: float, curvature: float) -> None:
    """As far as rounding of its three values lets it be."""
    signal = height - curvature * (np.arange(5.0) - 2.0 - place) ** 2
    tolerance = 1e-15 * (abs(height) + 4.0 * curvature) / curvature
    assert parabola_vertex(signal, 2) == pytest.approx(place, abs=4.0 * tolerance + 1e-12)


def test_what_does_not_bend_down_has_no_vertex() -> None:
    """The middle of three values on a line, or in a trough, is as good as any."""
    assert parabola_vertex(np.arange(3.0), 1) == 0.0
    assert parabola_vertex(np.array([1.0, 0.0, 2.0]), 1) == 0.0
