"""A frequency for samples whose velocity is not known yet."""

import numpy as np

from calcidem.dem.wave.experiment import Experiment

WAVELENGTHS = 2.5
"""Wavelengths of path: with fewer the near field is read, with many more little propagates."""

_PATTERNS = 3
"""Cement patterns that are looked at: their median is within some percent of that of hundreds."""

_SIGNIFICANT = 2
"""Significant digits of the frequency, so that every processor chooses the same one."""


def suitable_frequency(experiment: Experiment, content: float) -> float:
    """Give the frequency at which the path from transmitter to receiver is 2.5 wavelengths, Hz.

    The wavelength is that of the static speed, which needs no signal: the median of three cement patterns, those of the
    seeds 0, 1 and 2. The frequency is rounded to two digits. So it depends on nothing but the experiment and the
    content, and is the same on each rank and processor. `ValueError` if a sample has no stiffness.

    Parameters
    ----------
    experiment
        What samples share; its frequencies are not looked at.
    content
        Percent of the sand's mass.

    Notes
    -----
    On such a path the near field makes a standard error of 2 % at most, see
    `calcidem.dem.wave.reading.reading_error`.
    """
    speed = expected_speed(experiment, content, _PATTERNS)
    return float(f"{WAVELENGTHS * speed / experiment.distance:.{_SIGNIFICANT}g}")


def expected_speed(experiment: Experiment, content: float, patterns: int) -> float:
    """Give the median static speed of some cement patterns, those of the seeds from 0 on, m/s.

    `ValueError` if a sample has no stiffness.

    Parameters
    ----------
    experiment
        What samples share; its frequencies are not looked at.
    content
        Percent of the sand's mass.
    patterns
        Their number; without cement they are all the same.
    """
    # Each configuration names this module; only who calls it waits for the engine.
    from calcidem.dem.wave.static_speed import static_speed  # noqa: PLC0415

    seeds = range(patterns if content > 0.0 else 1)
    bonded = [experiment.ordering(seed).at(content).bonded for seed in seeds]
    return float(np.median([static_speed(experiment, flags).speed for flags in bonded]))
