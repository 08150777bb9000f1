from dataclasses import replace

import numpy as np
import pytest

from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment, WaveRule, suitable_frequency
from calcidem.dem.wave.static_speed import static_speed

WAVE = WaveRule(transmitter_half_width=0.01, receiver_half_width=0.012, boundary_thickness=0.012, listening_depth=0.006)


@pytest.fixture(scope="module")
def experiment(small_packing: Packing) -> Experiment:
    """Give samples whose frequency is chosen."""
    return Experiment(small_packing, cement_rule=CementRule(p_share=0.77), wave=WAVE, frequencies=suitable_frequency)


def test_the_path_is_two_and_a_half_wavelengths(experiment: Experiment) -> None:
    """The wavelength is the static speed over the frequency, of which two digits are kept."""
    bare = np.zeros(len(experiment.packing.pairs), dtype=bool)
    frequency = experiment.frequency(0.0)
    wavelengths = experiment.distance * frequency / static_speed(experiment, bare).speed
    assert wavelengths == pytest.approx(2.5, rel=0.05)
    assert frequency == float(f"{frequency:.1e}")


def test_stiffer_samples_have_a_higher_frequency(experiment: Experiment) -> None:
    """It grows with the content, and with the root of the stiffness of all contacts."""
    assert experiment.frequency(0.0) < experiment.frequency(2.55) < experiment.frequency(9.0)
    harder = replace(experiment, stiffness_factor=4.0)
    assert harder.frequency(0.0) == pytest.approx(2.0 * experiment.frequency(0.0), rel=0.05)


def test_a_content_is_looked_at_once(experiment: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was found is kept with the experiment."""
    fresh = replace(experiment)
    expected = fresh.frequency(0.66)
    monkeypatch.setattr("calcidem.dem.wave.static_speed.static_speed", None)
    assert fresh.frequency(0.66) == expected
