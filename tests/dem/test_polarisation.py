"""Telling P wave from S wave by how the grains move."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.arrival import is_settled, read_travel_times
from calcidem.dem.wave.pick import PickFailure, PickRule, Signals
from calcidem.dem.wave.polarisation import STEEPEST, along_over_across, find_p_waves
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.rule import WaveRule

WAY, FREQUENCY, INTERVAL = 0.094, 5e3, 2e-6
PERIOD = 1.0 / (FREQUENCY * INTERVAL)
PLACES = np.linspace(0.15, 1.0, 10)
RULE = PickRule(smoothing=0.4)


def section(velocity: float, duration: float = 2.2e-3, power: float = 0.0) -> Floats:
    """(T, X + 1) pulse that travels at one velocity, and grows with a power of the way; 1 at the receiver."""
    time = np.arange(0.0, duration, INTERVAL)
    return np.column_stack([p**power * Pulse(0.5, FREQUENCY).velocity(time - p * WAY / velocity) for p in PLACES])


def signals(across: Floats, along: Floats | None) -> Signals:
    """Signals of a section, the last column of which is the receiver's."""
    sent = Pulse(0.5, FREQUENCY).velocity(np.arange(len(across)) * INTERVAL)
    return Signals(INTERVAL, sent, across[:, -1], WAY, 1e-3, across[:, :-1], tuple(PLACES[:-1]), along)


def velocity_of(across: Floats, along: Floats | None) -> float | None:
    """Velocity by the peak."""
    return read_travel_times(signals(across, along), RULE).peak.velocity


@settings(max_examples=30, deadline=None)
@given(share=st.floats(-STEEPEST, STEEPEST), height=st.floats(0.1, 4.0), faster=st.floats(1.3, 2.0))
def test_the_share_of_a_p_wave_is_found_and_nothing_else_is_taken_off(
    share: float, height: float, faster: float
) -> None:
    """At every station; behind the P wave's swing the share is zero."""
    p_wave = height * section(faster * 230.0)
    shares, known = find_p_waves(share * p_wave, p_wave, len(p_wave), 1.0, PERIOD)
    assert known.all()
    over = np.cumsum(p_wave[::-1], axis=0)[::-1] == 0.0
    assert (shares[over] == 0.0).all()
    np.testing.assert_allclose((share - shares) * p_wave, 0.0, atol=1e-12 * height)


def test_a_shear_wave_of_its_own_keeps_its_bits() -> None:
    """Where nothing moves along the way, or less than a hundredth of what was sent, nothing is taken off."""
    across = section(230.0)
    alone = read_travel_times(signals(across, None), RULE)
    for along in (np.zeros_like(across), 0.009 * section(400.0)):
        assert read_travel_times(signals(across, along), RULE) == alone


def test_motion_across_that_comes_before_any_along_is_no_p_wave() -> None:
    """Its share would be that of the S wave."""
    shares, known = find_p_waves(section(400.0), section(230.0), 1100, 1.0, PERIOD)
    assert known.all()
    assert not shares.any()


def test_of_two_tops_the_one_that_moves_grains_across_is_read() -> None:
    """A P wave that comes at a slant looks like a faster S wave; without its motion along, either may be read."""
    p_wave, s_wave = section(390.0), section(230.0)
    across, along = s_wave + p_wave, 3.0 * p_wave + 0.2 * s_wave
    assert velocity_of(across, None) is None
    assert velocity_of(across, along) == pytest.approx(230.0, rel=0.02)


def test_of_two_shear_waves_the_first_is_read() -> None:
    """Neither moves grains along the way."""
    across = section(390.0) + 0.98 * section(230.0)
    assert read_travel_times(signals(across, None), RULE).peak.failure is PickFailure.LOST
    assert velocity_of(across, 0.2 * across) == pytest.approx(390.0, rel=0.02)


@pytest.mark.parametrize(
    ("first", "second", "velocity"),
    [(0.8, 0.8, 520.0), (0.8, 0.3, 230.0), (1.3, 0.8, None), (1.3, 1.3, None), (0.3, 1.3, 520.0)],
)
def test_of_likely_tops_the_first_is_read_if_it_moves_more_across_and_no_later_one_is_clearer(
    first: float, second: float, velocity: float | None
) -> None:
    """Neither of the motions along comes before its wave, so that nothing is taken off as a P wave's."""
    fast, slow = section(520.0), 0.98 * section(230.0)
    later = [np.roll(wave, int(PERIOD) // 4, axis=0) for wave in (fast, slow)]
    path = np.rint((0.5 / FREQUENCY + PLACES * WAY / 520.0) / INTERVAL).astype(int)
    as_large = np.median(1.0 / along_over_across(fast, later[0], path, 15))
    along = as_large * (first * later[0] + second * later[1])
    found = velocity_of(fast + slow, along)
    assert found == (None if velocity is None else pytest.approx(velocity, rel=0.02))


def test_a_small_shear_wave_ahead_makes_no_p_wave_of_a_later_one() -> None:
    """What comes behind a shear wave is none, though the first, as large on the way, is too small where it is read."""
    small, large = np.append(np.ones(len(PLACES) - 1), 0.4) * section(520.0), section(230.0)
    along = 0.2 * small + 1.4 * np.roll(large, int(PERIOD) // 4, axis=0)
    assert velocity_of(small + large, along) == pytest.approx(230.0, rel=0.02)


def test_a_p_wave_alone_is_no_shear_wave() -> None:
    """Even where what it does across cannot all be taken off, since it changes its direction on its way."""
    p_wave, time = section(390.0), np.arange(0.0, 2.2e-3, INTERVAL)
    turned = np.column_stack(
        [Pulse(0.5, FREQUENCY).velocity(time - place * WAY / 390.0 - 0.1 / FREQUENCY) for place in PLACES]
    )
    assert velocity_of(0.4 * turned, None) is not None
    assert velocity_of(0.4 * turned, p_wave) is None


@pytest.mark.parametrize("height", [0.3, 1.0, 3.0])
def test_a_record_that_ends_when_it_is_settled_has_the_same_reading(height: float) -> None:
    """To the last bit, whatever came of the P wave until then."""
    generator = np.random.default_rng(int(10 * height))
    p_wave = height * section(390.0, power=1.0) * np.exp(0.3 * generator.standard_normal(len(PLACES)))
    across, along = section(230.0) + 0.3 * p_wave, p_wave - 0.3 * height * np.roll(p_wave, 90, axis=0)
    whole = read_travel_times(signals(across, along), RULE)
    settled = [end for end in range(120, len(across), 10) if is_settled(signals(across[:end], along[:end]), RULE)]
    assert settled
    assert whole.peak.velocity is not None
    for end in settled[::8]:
        assert read_travel_times(signals(across[:end], along[:end]), RULE) == whole


def test_motions_are_compared_near_a_path() -> None:
    """By their rms, so that a tenth along is a tenth, of any sign."""
    across = section(230.0)
    path = np.rint((0.5 / FREQUENCY + PLACES * WAY / 230.0) / INTERVAL).astype(int)
    np.testing.assert_allclose(along_over_across(across, -0.1 * across, path, 15), 0.1, rtol=1e-12)


def test_polarisation_needs_stations() -> None:
    """The receiver alone does not show which way a wave has come."""
    assert WaveRule(stations=8, polarisation=True).polarisation
    with pytest.raises(ValueError, match="stations = 0: polarisation is told at stations; give 4 and more"):
        replace(WaveRule(), polarisation=True)
    with pytest.raises(ValueError, match="along: give stations, too"):
        replace(signals(section(230.0), section(390.0)), stations=None, places=())
