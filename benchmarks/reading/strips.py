"""Sections of elastic strips with a known delay, by finite differences, with one of three walls behind the receiver.

The strip has the size of the sample of `paper` between its damped layers. Its edges are held, its left wall moves as the
pulse, and its stiffness varies along the path. The S wave's delay is the integral of its slowness. From an *open* wall
nothing returns. A *smooth* wall is free across the path. A wall *held at the receiver* is fixed where the receiver is, and
smooth elsewhere. A sample's wall is between the last two, and its damping weakens what returns.

Stresses and velocities are at staggered places and times (J. Virieux 1986, doi:10.1190/1.1442147).
"""

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from section import Section

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.reading import record_duration
from calcidem.dem.wave.section import Pulse, clamp_of_strip

WALLS = ("open", "smooth", "held at the receiver")
LENGTH, HEIGHT = 0.1, 0.2  # m
_RECEIVER = 0.025  # half height of receiver and stations, m
_DEPTH = 0.01  # of the receiver before its wall, m
_DENSITY = 2139.0  # kg/m^3
_PER_SEED = 20


def strips_of_seed(seed: int) -> Iterable[Section]:
    """Draw strips, and compute each with all three walls."""
    generator = np.random.default_rng(seed)
    for index in range(_PER_SEED):
        wavelengths, ratio = generator.uniform(1.0, 2.5), generator.uniform(1.34, 1.58)
        waves = generator.standard_normal(3) * generator.uniform(0.0, 0.1)
        for wall in WALLS:
            yield compute_strip(wall, wavelengths, ratio, waves, group=_PER_SEED * seed + index)


def compute_strip(
    wall: str,
    wavelengths: float,
    ratio: float,
    waves: Floats,
    *,
    height: float = HEIGHT,
    spacing: float = 1.25e-3,
    group: int = 0,
) -> Section:
    """Section of a strip.

    Parameters
    ----------
    wall
        One of `WALLS`.
    wavelengths
        Number of wavelengths from wall to wall.
    ratio
        P over S wave speed; that of samples is 1.34 to 1.58 (`calcidem.dem.wave.section.P_OVER_S`).
    waves
        Heights of cosines along the path; their sum is the logarithm of the S wave speed over 300 m/s.
    height, spacing
        Of the strip, and of the grid, m.
    group
        See `Section`.
    """
    path = round(LENGTH / spacing)
    # An open wall is so far behind the place of the others that nothing returns before the record ends.
    sizes = (3 * path if wall == "open" else path, round(height / spacing))
    x, y = ((np.arange(size) + 0.5) * spacing for size in sizes)
    turns = np.outer(np.arange(1, len(waves) + 1), np.minimum(x / LENGTH, 1.0))
    speed = (300.0 * np.exp(waves @ np.cos(np.pi * turns)))[:, None]
    slowness = float(np.sum(1.0 / speed[:path])) / path
    frequency = wavelengths / (LENGTH * slowness)
    shear, whole = _DENSITY * speed**2, _DENSITY * (ratio * speed) ** 2
    at_faces = np.concatenate([shear[:1], 2.0 / (1.0 / shear[1:] + 1.0 / shear[:-1]), shear[-1:]])
    stride = int(np.ceil(ratio * speed.max() / (0.5 * spacing * 100.0 * frequency)))
    step = 1.0 / (100.0 * frequency * stride)  # 100 samples in a period, at most 0.7 of the stability limit
    # Long enough for a fit that is a quarter too slow.
    count = int(record_duration(LENGTH, 0.75 / slowness, frequency) / step)
    pulse = Pulse(1.0, frequency).velocity(np.arange(count) * step).tolist()
    # Motion is taken where stations and receiver of a sample would be.
    ends = (*np.linspace(LENGTH / 8.0, LENGTH - _DEPTH, 10), LENGTH)
    slices = [(low <= x) & (x < high) for low, high in pairwise(ends)]
    middle = np.abs(y - height / 2.0) < _RECEIVER
    held = middle & (wall == "held at the receiver")
    along, across = np.zeros((len(x) + 1, len(y) + 1)), np.zeros((len(x), len(y)))
    stress_along, stress_across = np.zeros((2, len(x), len(y) + 1))
    stress_shear, stretch = np.zeros((len(x) + 1, len(y))), np.zeros((len(x), len(y) + 1))
    motion = np.empty((2, len(slices), count))
    for number, sent in enumerate(pulse):
        # At a held edge the motion has the opposite sign behind it.
        stretch[:, 1:-1], stretch[:, 0], stretch[:, -1] = np.diff(across), 2.0 * across[:, 0], -2.0 * across[:, -1]
        shortened = np.diff(along, axis=0)
        stress_along += step / spacing * (whole * shortened + (whole - 2.0 * shear) * stretch)
        stress_across += step / spacing * ((whole - 2.0 * shear) * shortened + whole * stretch)
        sheared = np.diff(along)
        sheared[1:-1] += np.diff(across, axis=0)
        sheared[0] += 2.0 * (across[0] - sent)
        sheared[-1] = -2.0 * held * across[-1]
        stress_shear += step / spacing * at_faces * sheared
        stress_shear[-1] *= held
        force = np.diff(stress_along, axis=0)[:, 1:-1] + np.diff(stress_shear)[1:-1]
        along[1:-1, 1:-1] += step / (spacing * _DENSITY) * force
        across += step / (spacing * _DENSITY) * (np.diff(stress_shear, axis=0) + np.diff(stress_across))
        here = 0.25 * (along[1:, 1:] + along[:-1, 1:] + along[1:, :-1] + along[:-1, :-1])
        motion[:, :, number] = [[field[part][:, middle].mean() for part in slices] for field in (across, here)]
    places = np.array([x[part].mean() for part in slices])
    delay = float(np.interp(places[-1], x, np.cumsum(spacing / speed[:, 0]) - 0.5 * spacing / speed[:, 0]))
    return Section(
        kind=wall,
        group=group,
        times=(np.arange(count) + 1.0) * step,
        places=places / places[-1],
        across=motion[0],
        along=motion[1],
        distance=float(places[-1]),
        amplitude=1.0,
        frequency=frequency,
        delay=delay,
        delay_error=0.0,
        aperture=float("inf"),
        clamp=clamp_of_strip(height),
        readable=True,
    )
