"""Phase velocity against frequency, from the space-time sections of many samples of one content.

One sample holds one to three wavelengths, so its spectrum over frequency and wavenumber is broad. The mean of the
spectra of many samples gives the dispersion of the content and the speed of its long waves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_VELOCITIES = 400  # of the grid, evenly spaced by their logarithm
FEWEST_SECTIONS = 3
"""Samples that a jackknife needs."""

_RESOLVED = 1e-3  # of a velocity, which a parabola over that grid resolves


@dataclass(frozen=True, slots=True, eq=False)
class SectionMotion:
    """Motion across the path of one sample.

    Attributes
    ----------
    times
        (T,) s, evenly spaced.
    places
        (X,) m along the path.
    across
        (T, X) velocity, any unit.
    """

    times: NDArray[np.float64]
    places: NDArray[np.float64]
    across: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Dispersion:
    """Dispersion of the shear waves of one content.

    Attributes
    ----------
    frequency
        (F,) Hz.
    velocity
        (V,) m/s.
    power
        (F, V) mean over the samples of the stacked power, from 0 to 1: 1 where all places move in phase.
    phase_velocity, standard_error
        (F,) velocity of the largest power and its standard error by the jackknife over samples, m/s.
    long_wave, long_wave_error
        Limit at frequency zero and its standard error, m/s.
    samples
        How many samples.
    """

    frequency: NDArray[np.float64]
    velocity: NDArray[np.float64]
    power: NDArray[np.float64]
    phase_velocity: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    long_wave: float
    long_wave_error: float
    samples: int


@dataclass(frozen=True, slots=True)
class ContentDispersion:
    """Dispersion at one content.

    Attributes
    ----------
    content
        Percent.
    found
        Result of the sections.
    vs, static
        Medians of Vs and of the static speed of the samples, m/s; NaN where the latter is not known.
    """

    content: float
    found: Dispersion
    vs: float
    static: float


def dispersion(
    sections: Sequence[SectionMotion],
    frequency: float,
    velocities: tuple[float, float],
    *,
    shares: Sequence[float] = tuple(np.arange(0.4, 1.81, 0.1).round(2).tolist()),
) -> Dispersion:
    """Find the phase velocity of shear waves from sections of samples of one content.

    `ValueError` if there are fewer than three sections, or the velocities are not an increasing pair of positive
    numbers.

    Parameters
    ----------
    sections
        Of three samples and more, from the transmitted pulse to the end of the received one.
    frequency, velocities
        Of the pulse, Hz, and the slowest and fastest phase velocity that is looked for, m/s.
    shares
        Frequencies of the result over that of the pulse, whose spectrum is zero at 2.

    Notes
    -----
    At each frequency the spectra of all places, each over its own absolute value, are shifted by the phase of a plane
    wave and summed (phase-shift method: Park, Miller and Xia 1998, SEG Expanded Abstracts 17:1377). The power of this
    sum is averaged over the samples. The long-wave limit is the intercept of the phase velocity over the square of the
    frequency, each weighted by its standard error: a lattice of spacing d has ``c = c0 (1 - (pi f d / c0)^2 / 6)``.
    """
    if len(sections) < FEWEST_SECTIONS:
        raise ValueError(f"sections: {len(sections)} given; give those of three samples and more")
    if not 0.0 < velocities[0] < velocities[1]:
        raise ValueError(f"velocities = {velocities}: give a slowest and a fastest positive velocity, m/s")
    wanted = frequency * np.asarray(shares, dtype=float)
    velocity = np.geomspace(*velocities, _VELOCITIES)
    waves: dict[bytes, NDArray[np.complex128]] = {}  # sections of one content have much the same times and places
    powers = np.array([_power(section, wanted, velocity, waves) for section in sections])
    total, count = powers.sum(axis=0), len(sections)
    found, left_out = _ridge(total, velocity), np.array([_ridge(total - power, velocity) for power in powers])
    error = _jackknife(left_out)
    known = np.maximum(error, _RESOLVED * found)  # no less than the resolution of the grid
    limits = np.array([_long_wave(wanted, ridge, known) for ridge in left_out])
    return Dispersion(
        frequency=wanted,
        velocity=velocity,
        power=total / count,
        phase_velocity=found,
        standard_error=error,
        long_wave=_long_wave(wanted, found, known),
        long_wave_error=float(_jackknife(limits)),
        samples=count,
    )


def _power(
    section: SectionMotion,
    frequency: NDArray[np.float64],
    velocity: NDArray[np.float64],
    waves: dict[bytes, NDArray[np.complex128]],
) -> NDArray[np.float64]:
    """(F, V) stacked power of one sample; `waves` keeps the waves (F, T) and (F, V, X) at its times and places."""
    times, places = section.times.tobytes(), section.places.tobytes()
    if times not in waves:
        waves[times] = np.exp(-2j * np.pi * frequency[:, None] * section.times)
    if places not in waves:
        waves[places] = np.exp(2j * np.pi * frequency[:, None, None] / velocity[:, None] * section.places)
    spectrum = waves[times] @ section.across
    spectrum = spectrum / np.maximum(np.abs(spectrum), np.finfo(float).tiny)
    stacked = (waves[places] @ spectrum[:, :, None])[:, :, 0] / len(section.places)
    return np.asarray(np.abs(stacked) ** 2)


def _ridge(power: NDArray[np.float64], velocity: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F,) velocity of the largest power, between those of the grid by a parabola over the logarithm."""
    best = np.clip(power.argmax(axis=1), 1, len(velocity) - 2)
    rows = np.arange(len(power))
    left, middle, right = (power[rows, best + shift] for shift in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    shift = np.where(bend < 0.0, 0.5 * (left - right) / np.where(bend < 0.0, bend, -1.0), 0.0)
    step = np.log(velocity[1] / velocity[0])
    return np.asarray(velocity[best] * np.exp(np.clip(shift, -1.0, 1.0) * step))


def _long_wave(
    frequency: NDArray[np.float64], phase_velocity: NDArray[np.float64], error: NDArray[np.float64]
) -> float:
    """Limit of the phase velocity at frequency zero, m/s."""
    _, intercept = np.polyfit(frequency**2, phase_velocity, 1, w=1.0 / error)
    return float(intercept)


def _jackknife(left_out: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard error from estimates (N, ...) with one sample left out each."""
    count = len(left_out)
    return np.asarray(np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)))
