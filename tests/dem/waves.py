"""Sections of waves that are written down, for the tests of their reading; velocities are over v0, times in periods."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.section import Pulse, Section, quantise

FREQUENCY, AMPLITUDE, DISTANCE = 5e3, 1e-3, 0.094
PARTS = (*np.linspace(0.15, 0.9, 9).tolist(), 1.0)
"""Places of nine stations and of the receiver, over the distance."""
ONE = Pulse(0.5, 1.0)
"""Pulse of one period that rises to 1."""

Wave = Callable[[float, Floats], Floats]
"""Velocity at a place (over the distance) and at times."""


def wave(travel: float, height: float = 1.0, faster: float = 1.0) -> Wave:
    """Pulse that takes so many periods to the receiver; ``faster`` is its frequency, its peak stays."""
    return lambda part, time: height * ONE.velocity(faster * (time - 0.5 - part * travel) + 0.5)


def guided(travel: float, clamp: float) -> Wave:
    """Wave in a strip that delays long waves by nothing and short ones by so many periods; K times the distance."""
    return lambda part, time: np.interp(time, _FINE, _guided_at(part, travel, clamp), left=0.0)


_FINE = np.arange(64 * 500) / 500.0
"""Times of guided waves, which repeat after 64 periods."""


@lru_cache(maxsize=1000)
def _guided_at(part: float, travel: float, clamp: float) -> Floats:
    """Inverse Laplace transform by FFT; damped by e^-16 over its length, so that nothing comes round."""
    slow = 0.25
    rate = slow + 2.0j * np.pi * np.fft.rfftfreq(len(_FINE), _FINE[1])
    sent = np.fft.rfft(np.exp(-slow * _FINE) * ONE.velocity(_FINE))
    path = np.sqrt((rate * travel) ** 2 + clamp**2) * part
    return np.asarray(np.exp(slow * _FINE) * np.fft.irfft(sent * np.exp(-path), len(_FINE)))


def at_receiver(motion: Wave) -> Wave:
    """The same at the receiver, and nothing at the stations."""
    return lambda part, time: motion(part, time) * (part == 1.0)


def total(*motions: Wave) -> Wave:
    """Sum of motions."""
    return lambda part, time: np.sum([motion(part, time) for motion in motions], axis=0)


def silence(part: float, time: Floats) -> Floats:
    """Nothing moves."""
    return 0.0 * part * time


def section(
    across: Wave,
    along: Wave = silence,
    *,
    duration: float = 20.0,
    samples: int = 40,
    parts: tuple[float, ...] = PARTS,
) -> Section:
    """Section of motions, recorded for so many periods; the first sample is not at time zero."""
    interval = 1.0 / (FREQUENCY * samples)
    time = (0.3 + np.arange(int(duration * samples))) / samples
    motions = ([AMPLITUDE * motion(part, time) for part in parts] for motion in (across, along))
    counts = (quantise(np.column_stack(columns), AMPLITUDE) for columns in motions)
    places = tuple(DISTANCE * part for part in parts)
    return Section(interval, 0.3 * interval, FREQUENCY, AMPLITUDE, places, *counts)


def periods(velocity: float | None) -> float:
    """Travel time that a velocity stands for, in periods; fails if there is none."""
    assert velocity is not None
    return DISTANCE * FREQUENCY / velocity
