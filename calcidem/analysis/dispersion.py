"""Phase velocity over frequency, from the space-time sections of many samples of one content.

One sample contains one to three wavelengths, so its spectrum over frequency and wavenumber is broad. The mean spectrum
of many samples gives the dispersion of the content and its long-wave speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Dispersion:
    """Dispersion of the shear waves of one content."""

    frequency: NDArray[np.float64]
    """(F,) Hz."""
    velocity: NDArray[np.float64]
    """(V,) m/s."""
    power: NDArray[np.float64]
    """(F, V) mean stacked power of the samples, from 0 to 1: 1 if all places move in phase."""
    phase_velocity: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    """(F,) velocity of the largest power and its jackknife standard error, m/s; NaN for fewer than three samples."""
    long_wave: float
    long_wave_error: float
    """Limit at frequency zero and its standard error, m/s; NaN for fewer than three samples."""
    samples: int


@dataclass(frozen=True, slots=True)
class ContentDispersion:
    """Dispersion at one content."""

    content: float
    """Percent."""
    found: Dispersion
    vs: float
    static: float
    """Medians of Vs and of the static speed of the samples, m/s; NaN if the latter is unknown."""


def dispersion(
    sections: Sequence[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]],
    frequency: float,
    velocities: tuple[float, float],
    *,
    shares: Sequence[float] = tuple(np.arange(0.4, 1.81, 0.1).round(2).tolist()),
) -> Dispersion:
    """Return the phase velocity of shear waves from sections of samples of one content.

    `ValueError` without sections, or if the velocities are not an increasing pair of positive numbers.

    Parameters
    ----------
    sections
        Motion across the path of each sample, from the transmitted pulse to the end of the received one:
        times (T,), s, evenly spaced; places along the path (X,), m; and velocities (T, X) in any unit.
    frequency, velocities
        Frequency of the pulse, Hz, and the range of phase velocities to search, m/s.
    shares
        Frequencies of the result over that of the pulse, whose spectrum is zero at 2.

    Notes
    -----
    At each frequency the spectra of all places are normalised to unit magnitude, shifted by the phase of a plane wave
    and summed (phase-shift method: Park, Miller and Xia 1998, SEG Expanded Abstracts 17:1377). The power of this sum is
    averaged over the samples. The long-wave limit is the intercept of the phase velocity over the squared frequency,
    weighted by standard errors: a lattice of spacing d has ``c = c0 (1 - (pi f d / c0)^2 / 6)``.
    """
    if not sections:
        raise ValueError("sections: none given; give that of a sample, or of three for a standard error")
    if not 0.0 < velocities[0] < velocities[1]:
        raise ValueError(f"velocities = {velocities}: give a slowest and a fastest positive velocity, m/s")
    wanted = frequency * np.asarray(shares, dtype=float)
    velocity = np.geomspace(*velocities, 400)
    waves: dict[bytes, NDArray[np.complex128]] = {}  # sections of one content share most times and places
    powers = np.array([_power(section, wanted, velocity, waves) for section in sections])
    total, count = powers.sum(axis=0), len(sections)
    found, left_out = _ridge(total, velocity), np.array([_ridge(total - power, velocity) for power in powers])
    error = _jackknife(left_out)
    known = np.fmax(error, 1e-3 * found)  # at least the resolution of the grid by a parabola
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
    section: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    frequency: NDArray[np.float64],
    velocity: NDArray[np.float64],
    waves: dict[bytes, NDArray[np.complex128]],
) -> NDArray[np.float64]:
    """(F, V) stacked power of one sample; `waves` caches the waves (F, T) and (F, V, X) at its times and places."""
    times, places, across = section
    at_times, at_places = times.tobytes(), places.tobytes()
    if at_times not in waves:
        waves[at_times] = np.exp(-2j * np.pi * frequency[:, None] * times)
    if at_places not in waves:
        waves[at_places] = np.exp(2j * np.pi * frequency[:, None, None] / velocity[:, None] * places)
    spectrum = waves[at_times] @ across
    spectrum = spectrum / np.maximum(np.abs(spectrum), np.finfo(float).tiny)
    stacked = (waves[at_places] @ spectrum[:, :, None])[:, :, 0] / len(places)
    return np.asarray(np.abs(stacked) ** 2)


def _ridge(power: NDArray[np.float64], velocity: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F,) velocity of the largest power, refined by a parabola over the logarithm."""
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
    """Standard error from estimates (N, ...) that each leave out one sample."""
    count = len(left_out)
    if count < 3:
        return np.full_like(left_out[0], np.nan)
    return np.asarray(np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)))
