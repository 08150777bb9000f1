"""The pulse; the space-time section it leaves, and the damped wave in a strip fitted to it: the effective velocity.

The section has the records of the receiver and of the stations on the path.

The damped layers at floor and lid hold the disks there, so the sample between them is a waveguide. Its shear wave moves
as ``cos(pi y / h)`` across the strip of height h. While it shears the sample along the path, it stretches it across,
where P waves have their speed. So ``omega^2 = c^2 (k^2 + K^2)`` with ``K = pi / h`` times the ratio of P to S wave
speed: low frequencies travel too fast (waveguides: J.D. Achenbach, Wave Propagation in Elastic Solids, 1973, section
6.2). Peaks follow this dispersion, the fitted c does not.

The fit compares Laplace transforms of the stations' motion with those of the wave, at frequencies whose real part damps
reflections and the end of the record (M. Bouchon 2003, doi:10.1007/PL00012545). Cement focuses a wave, so each station
has a gain of its own, and c is the only unknown. Nothing is picked or smoothed.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.portable import cosine_and_sine, exponential, parabola_vertex, sine_of_turns
from calcidem.dem.kernels.layout import Floats

RESOLUTION = 2.0**-20
"""Resolution of recorded velocities over the amplitude of the pulse: 1e-3 of the weakest accepted arrival."""

Counts = npt.NDArray[np.int32]


def quantise(velocity: Floats, amplitude: float) -> Counts:
    """Velocities in multiples of `RESOLUTION`; NaN and values far above any wave become the largest count."""
    steps = np.rint(velocity / (amplitude * RESOLUTION))
    # Far above any wave, and half of what int32 holds.
    return np.where(np.abs(steps) < 2**30, steps, 2**30).astype(np.int32)


@dataclass(frozen=True, slots=True)
class Pulse:
    """One period of ``v(t) = v0 (1 - cos 2 pi f t)``, then rest (paper, section 2.2.2)."""

    amplitude: float
    """v0, m/s; the peak velocity is twice this. The paper's 5 m/s is a shock at 5 kPa, not a small strain."""
    frequency: float
    """f, Hz."""

    def __post_init__(self) -> None:
        """Refuse a pulse without motion or without end."""
        if not 0.0 < abs(self.amplitude) < np.inf:
            raise ValueError(f"amplitude = {self.amplitude} m/s: give a finite velocity other than 0")
        if not 0.0 < self.frequency < np.inf:
            raise ValueError(f"frequency = {self.frequency} Hz: give a positive, finite frequency")

    @property
    def stroke(self) -> float:
        """Displacement that remains after the pulse, v0 / f, m."""
        return self.amplitude / self.frequency

    def velocity(self, time: npt.ArrayLike) -> Floats:
        """Return the velocity at times (s, any shape), m/s; zero before 0 and after one period."""
        cycle = np.clip(self.frequency * np.asarray(time, dtype=float), 0.0, 1.0)
        return np.asarray(self.amplitude * (2.0 * sine_of_turns(0.5 * cycle) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Velocities at places on the path, across the path (y) and along it (x), in multiples of `RESOLUTION`.

    Live and stored readings use the same integers, so both give the same bits. The fields with a default describe the
    run that recorded it; a section from a store has none of them.
    """

    sampling_interval: float
    """Time between two samples, s."""
    start_time: float
    """Time of the first sample after the pulse began, s."""
    frequency: float
    """Frequency of the pulse ``v0 (1 - cos 2 pi f t)``, Hz."""
    amplitude: float
    """v0, m/s."""
    places: tuple[float, ...]
    """(X,) path from the transmitter to each station, and last to the receiver, m."""
    across: Counts
    along: Counts
    """(T, X) velocities over ``amplitude * RESOLUTION``, positive as the pulse and away from the transmitter."""
    time_step: float = math.nan
    """Time step of the integration, s."""
    stability_limit: float = math.nan
    """Critical time step at the start, s."""
    steps: int = 0
    """Time steps of this sample."""
    unbalanced_speed: float = 0.0
    """See `propagation.unbalanced_speed`."""
    broken_bonds: int = 0
    """Number of bonds that broke."""
    remaining_speed: float = math.inf
    """Bound of all later velocities of the section, m/s: those of a station if it held all energy of the sample."""
    problem: str = ""
    """Cause of unreliable results; empty if there is none."""
    retry: str = ""
    """Problem for which the sample was recomputed with half the step; empty if it was not."""

    @property
    def distance(self) -> float:
        """Path from the transmitter to the receiver, m."""
        return self.places[-1]

    @property
    def times(self) -> Floats:
        """(T,) s."""
        return self.start_time + self.sampling_interval * np.arange(len(self.across))

    @property
    def duration(self) -> float:
        """Recorded time, s."""
        return len(self.across) * self.sampling_interval

    @property
    def received(self) -> Floats:
        """(T,) velocity of the receiver across the path, m/s."""
        return np.asarray(self.across[:, -1] * (self.amplitude * RESOLUTION))

    @property
    def transmitted(self) -> Floats:
        """(T,) velocity of the transmitter, m/s."""
        return Pulse(self.amplitude, self.frequency).velocity(self.times)

    @property
    def period(self) -> float:
        """Duration of the pulse, samples."""
        return 1.0 / (self.frequency * self.sampling_interval)

    @property
    def transmitted_peak(self) -> float:
        """Time of the pulse's peak, samples."""
        return (0.5 / self.frequency - self.start_time) / self.sampling_interval

    def until(self, samples: int) -> Self:
        """First samples of the section."""
        return replace(self, across=self.across[:samples], along=self.along[:samples])


P_OVER_S = 1.4
"""Ratio of P to S wave speed: 1.34 to 1.58 for disks whose contacts have shear stiffnesses of 1 to 1/3 of the normal
stiffness. The clamp K is known to 15 %: sections of uniform packings fit best with 0.9 to 1.0 of it, although their
static moduli have a ratio of 1.8, since the layers give way a little (benchmarks/velocity/clamp.py).
"""

_DAMPING = 0.5
"""Real part of the transforms' frequencies over that of the pulse. More favours the P wave, which comes early; less
lets reflections and the end of the record in.
"""

_SPACING = 8
"""Frequencies of the transforms are those of the pulse over 8 apart, so the wave repeats after 8 periods, damped by
exp(-4).
"""

_TERMS = 24
"""Number of frequencies of a waveform: up to three times that of the pulse. The fit uses those up to once."""


FEWEST_STATIONS = 3
"""Stations beyond half of the path, the receiver included, that a jackknife needs."""


class StripWave(NamedTuple):
    """Wave that fits a section best."""

    velocity: float
    """Effective velocity c, m/s."""
    error: float
    """Its relative standard error: root of the sum of squares of the jackknife over the stations, and of the change by
    15 % of K. 1 with fewer than three stations, or at an end of the velocities tried.
    """
    coherence: float
    """Mean over the stations of the squared correlation of section and wave; 1 is a perfect fit."""
    clamp: float
    """K, 1/m."""


def clamp_of_strip(height: float) -> float:
    """K of a strip of a height between clamped edges, both SI units."""
    return np.pi * P_OVER_S / height


def far_stations(places: tuple[float, ...]) -> tuple[float, ...]:
    """Places beyond half of the path, m: there P and S wave have separated, and the near field is weak."""
    return tuple(place for place in places if place >= 0.5 * places[-1])


@lru_cache(maxsize=64)  # the look that ends a record, and its reading
def fit_wave(section: Section, clamp: float) -> StripWave | None:
    """Fit a damped wave to the stations beyond half of the path; None if one of them has not moved.

    Parameters
    ----------
    section
        Section up to the present.
    clamp
        K of the strip, 1/m; 0 for a plane wave.
    """
    motion = _transform(section)
    if motion is None:
        return None
    velocity, velocities, misfit = _fit(section, motion, clamp)
    stiffer, *_ = _fit(section, motion, 1.15 * clamp)
    total, count = misfit.sum(axis=1), misfit.shape[1]
    coherence = 1.0 - float(total.min()) / count
    if count < FEWEST_STATIONS or not 0 < total.argmin() < len(total) - 1:
        return StripWave(velocity, 1.0, coherence, clamp)
    left_out = np.array([_least(velocities, total - misfit[:, one]) for one in range(count)]) / velocity - 1.0
    apart = left_out - left_out.mean()
    jackknife = (count - 1) / count * float((apart * apart).sum())
    held = stiffer / velocity - 1.0
    return StripWave(velocity, float(np.sqrt(jackknife + held * held)), coherence, clamp)


def fit_velocity(section: Section, clamp: float) -> float | None:
    """Velocity of `fit_wave`, m/s, without its error, in a third of the time."""
    motion = _transform(section)
    return None if motion is None else _fit(section, motion, clamp)[0]


def _fit(section: Section, motion: Floats, clamp: float) -> tuple[float, Floats, Floats]:
    """Best velocity, velocities (V,), all m/s, and their misfits (V, X) to the transforms of the section's motion."""
    far = far_stations(section.places)
    velocities, wave = _waves_of_velocities(section.frequency, section.places[-1], far, clamp)
    misfit = 1.0 - _squared_correlation(motion, wave)
    return _least(velocities, misfit.sum(axis=1)), velocities, misfit


def fitness(section: Section, clamp: float, velocities: Floats) -> Floats:
    """Coherence of section and waves of these velocities (V,), m/s; NaN if a station has not moved."""
    motion = _transform(section)
    if motion is None:
        return np.full(len(velocities), np.nan)
    waves = _normalised_waves(section.frequency, velocities, far_stations(section.places), clamp)
    found = _squared_correlation(motion, waves)
    return np.asarray(found.mean(axis=1))


def waveform(wave: StripWave, frequency: float, places: tuple[float, ...], times: Floats) -> Floats:
    """Motion (X, T) of a wave at places, m, over v0, at times (X, T), s, after the pulse: the inverse transform."""
    real, imaginary = _wave(frequency, np.array([wave.velocity]), places, wave.clamp, _TERMS)[:, 0].swapaxes(1, 2)
    turns = frequency * (times[:, :, None] * ((np.arange(_TERMS) + 0.5) / _SPACING))
    cosine, sine = cosine_and_sine(turns)
    growth = exponential(_DAMPING * frequency * times)
    motion = (real[:, None] * cosine - imaginary[:, None] * sine).sum(axis=2)
    return np.asarray(2.0 * frequency / _SPACING * growth * motion)


def _transform(section: Section) -> Floats | None:
    """(2, S, X) real and imaginary parts of the Laplace transforms of the motion of the far stations over v0, s.

    None if one of them has not moved.
    """
    motion = np.ascontiguousarray((section.across[:, -len(far_stations(section.places)) :] * RESOLUTION).T)
    if not motion.any(axis=1).all():
        return None
    samples = motion.shape[1]
    kernel = _laplace_kernel(
        section.frequency, section.start_time, section.sampling_interval, samples + -samples % 256
    )[:, :, None, :samples]
    return np.asarray((kernel * motion).sum(axis=3))


@lru_cache(maxsize=64)  # the looks at one record, some of each lane, and its reading need the same
def _laplace_kernel(frequency: float, start_time: float, sampling_interval: float, samples: int) -> Floats:
    """(2, S, T) factors of the samples of a section in its transforms, s."""
    times = start_time + sampling_interval * np.arange(samples)
    decay = exponential(-_DAMPING * frequency * times) * sampling_interval
    cosine, sine = cosine_and_sine(frequency * np.outer((np.arange(_SPACING) + 0.5) / _SPACING, times))
    return np.asarray(np.stack([cosine, -sine]) * decay)


def _squared_correlation(motion: Floats, wave: Floats) -> Floats:
    """(V, X) squared correlation of a section (2, S, X) and normalised waves (2, V, S, X); 0 for the other sense."""
    product = np.maximum(_sum_of_terms(wave * motion[:, None]), 0.0)
    return np.asarray(product * product / (motion * motion).sum(axis=(0, 1)))


@lru_cache(maxsize=64)
def _waves_of_velocities(
    frequency: float, distance: float, places: tuple[float, ...], clamp: float
) -> tuple[Floats, Floats]:
    """Velocities (V,), m/s, and their normalised waves; the same for all samples of a content."""
    # From 0.3 to 8 wavelengths on the path; each velocity is 1.67 % smaller than the one before.
    wavelengths = 0.3 * np.cumprod(np.r_[1.0, np.full(199, 1.0167)])
    velocities = distance * frequency / wavelengths
    return velocities, _normalised_waves(frequency, velocities, places, clamp)


def _normalised_waves(frequency: float, velocities: Floats, places: tuple[float, ...], clamp: float) -> Floats:
    """(2, V, S, X) waves with a sum of squares of 1 over the frequencies S of each velocity and place."""
    wave = _wave(frequency, velocities, places, clamp, _SPACING)
    return np.asarray(wave / np.sqrt(_sum_of_terms(wave * wave))[:, None, :])


def _wave(frequency: float, velocities: Floats, places: tuple[float, ...], clamp: float, terms: int) -> Floats:
    """(2, V, S, X) transforms of waves of velocities (V,) at places (X,), over v0, s."""
    real, imaginary = _DAMPING * frequency, 2.0 * np.pi * frequency * (np.arange(terms) + 0.5) / _SPACING
    # The square root of (s / c)^2 + K^2, whose real part decays along the path.
    over = 1.0 / (velocities * velocities)[:, None]
    a = over * (real * real - imaginary * imaginary) + clamp * clamp
    b = over * (2.0 * real * imaginary)
    size = np.sqrt(a * a + b * b)
    decay = np.sqrt(0.5 * (size + a))
    turn = 0.5 * b / decay
    path = np.array(places)
    cosine, sine = cosine_and_sine(turn[:, :, None] * path / (2.0 * np.pi))
    height = exponential(-decay[:, :, None] * path)
    sent = _pulse(frequency, real, imaginary)[:, :, None]
    return np.stack([height * (sent[0] * cosine + sent[1] * sine), height * (sent[1] * cosine - sent[0] * sine)])


def _pulse(frequency: float, real: float, imaginary: Floats) -> Floats:
    """(2, S) transform of one period of ``1 - cos 2 pi f t``: ``(1 - e^(-s / f)) w^2 / (s (s^2 + w^2))``, s."""
    cosine, sine = cosine_and_sine(imaginary / frequency / (2.0 * np.pi))
    fall = float(exponential(-real / frequency))
    w = 2.0 * np.pi * frequency
    # s (s^2 + w^2) = p + i q
    x, y = real * real - imaginary * imaginary + w * w, 2.0 * real * imaginary
    p, q = real * x - imaginary * y, real * y + imaginary * x
    up, over = np.stack([1.0 - fall * cosine, fall * sine]), w * w / (p * p + q * q)
    return np.stack([over * (up[0] * p + up[1] * q), over * (up[1] * p - up[0] * q)])


def _sum_of_terms(values: Floats) -> Floats:
    """(V, X) sums of (2, V, S, X) over parts and frequencies, in a fixed order."""
    both = values[0] + values[1]
    total = both[:, 0].copy()
    for term in range(1, both.shape[1]):
        total += both[:, term]
    return np.asarray(total)


def _least(velocities: Floats, misfit: Floats) -> float:
    """Velocity at the minimum of a misfit (V,), by a parabola through three values."""
    place = int(misfit.argmin())
    if not 0 < place < len(misfit) - 1:
        return float(velocities[place])
    shift = parabola_vertex(-misfit, place)
    faster, here, slower = (float(velocity) for velocity in velocities[place - 1 : place + 2])
    return here + shift * (slower - here if shift > 0.0 else here - faster)
