"""Tops of signals, how far they stand out and how broad they are."""

import numpy as np
import pytest
from scipy.signal import find_peaks, peak_prominences, peak_widths

from calcidem.dem.wave.tops import find_tops, half_width, prominence


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("levels", [0, 4])
def test_tops_are_those_of_scipy_to_the_last_bit(smooth: bool, levels: int) -> None:
    """Tops, level ones too, prominences and widths are what SciPy finds in random signals of any length."""
    generator = np.random.default_rng(7)
    for size in (1, 2, 3, 40, 300):
        signal = generator.normal(size=size)
        signal = np.cumsum(signal) if smooth else signal
        signal = np.round(signal * levels) if levels else signal
        tops = find_tops(signal)
        assert tops.tolist() == find_peaks(signal)[0].tolist()
        if not len(tops):
            continue
        assert [prominence(signal, top) for top in tops.tolist()] == peak_prominences(signal, tops)[0].tolist()
        _, _, began, ended = peak_widths(signal, tops, rel_height=0.5)
        assert [half_width(signal, top) for top in tops.tolist()] == list(
            zip(began.tolist(), ended.tolist(), strict=True)
        )


def test_a_signal_that_only_rises_has_no_width() -> None:
    """The last sample of a rising signal stands out of nothing."""
    signal = np.arange(4.0)
    assert not len(find_tops(signal))
    assert prominence(signal, 3) == 0.0
    assert half_width(signal, 3) == (3.0, 3.0)
