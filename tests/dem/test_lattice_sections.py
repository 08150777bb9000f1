"""The second generator of sections: its known delays against closed forms, and its waves against the known delays."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks" / "reading"))

from lattice_sections import (
    LANES,
    SPACING,
    Lattice,
    Trial,
    bloch_delay,
    draw_trial,
    long_wave_speeds,
    plane_waves,
    shear_branch,
    simulate,
)
from section import peak_time


def plain_trial(kind: str) -> tuple[Lattice, Trial]:
    """A lattice without disorder, and a wave over its whole height without damping."""
    lattice, trial = draw_trial(np.random.default_rng(3), kind)
    plane = {"half_aperture": 0.5 * lattice.height * trial.copies, "half_band": 4.0 * SPACING}
    return lattice, replace(trial, **plane, slant=0.0, rubbed=False, closed=False, damping=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_two_ways_to_the_known_delay_agree(kind: str) -> None:
    """The peak that a cell passes on is as late as the pulse's spectrum with the lattice's dispersion, within 1 %."""
    lattice, trial = plain_trial(kind)
    tilt = 0.0 if len(np.unique(np.round(lattice.y, 9))) == 2 else np.pi / 6.0
    waves = plane_waves(lattice, trial)
    for lane in (0, 1):
        path = float(waves[lane].whole_distances[27])
        found, _ = waves[lane].delay(27, path)
        expected, _ = bloch_delay(lattice, replace(trial, tilt=tilt), lane, path)
        # Driven disks do not turn, and are two zigzag columns: half a spacing of the path.
        assert found == pytest.approx(expected, rel=0.01)


def test_long_waves_have_the_speed_of_theory() -> None:
    """The quasi-shear branch begins with c_s^2 = k_s a^2 / 2 m, and 3/8 (k_n + k_s) a^2 / m at any tilt."""
    for kind in ("square", "hexagonal"):
        lattice, _ = plain_trial(kind)
        for tilt in (0.0, 0.2) if kind == "hexagonal" else (0.0,):
            number = np.array([1e-3 / SPACING])
            for lane in (0, 1):
                speed = shear_branch(lattice, tilt, bool(lane), number)[0] / number[0]
                closed = long_wave_speeds(lattice)[lane]
                assert speed == pytest.approx(closed, rel=1e-4)


@pytest.mark.full
def test_the_kernel_passes_a_plane_wave_on_as_the_independent_solution_does() -> None:
    """In a tall square lattice both peaks are at one time within 0.1 %, until something comes from lid and floor."""
    lattice, trial = plain_trial("square")
    trial = replace(trial, copies=3 * trial.copies, frequencies=trial.frequencies[:1] * LANES)
    trial = replace(trial, half_aperture=0.5 * lattice.height * trial.copies)
    times, across, along, distances = simulate(lattice, trial)
    waves = plane_waves(lattice, trial)
    for lane in (0, 1):
        delay, _ = waves[lane].delay(15, float(distances[15]))
        pulse_peak = 0.5 / trial.frequencies[lane]
        found = peak_time(times, across[:, 15, lane], times < pulse_peak + 1.3 * delay) - pulse_peak
        assert found == pytest.approx(delay, rel=1e-3)
        assert np.abs(along[times < pulse_peak + delay, 15, lane]).max() < 0.02
