"""Frequency for samples of unknown velocity."""

import numpy as np

from calcidem.dem.wave.experiment import Experiment

WAVELENGTHS = 2.5
"""Path over wavelength: with fewer wavelengths the near field disturbs, with many more little propagates."""

_PATTERNS = 3
"""Number of cement patterns; their median is within some percent of that of hundreds."""

_SIGNIFICANT = 2
"""Significant digits of the frequency, few enough that every processor chooses the same."""


def suitable_frequency(experiment: Experiment, content: float) -> float:
    """Return the frequency at which the path from transmitter to receiver is 2.5 wavelengths, Hz.

    The wavelength follows from the static speed, which needs no signal: the median over the cement patterns of the
    seeds 0, 1 and 2. The frequency is rounded to two digits. It depends only on experiment and content, and is the same
    on each rank and processor. `ValueError` if a sample has no stiffness.

    Parameters
    ----------
    experiment
        Common settings; its frequencies are ignored.
    content
        Percent of the sand's mass.

    Notes
    -----
    On such a path the near field causes a standard error of at most 2 %, see
    `calcidem.dem.wave.reading.reading_error`.
    """
    speed = expected_speed(experiment, content, _PATTERNS)
    return float(f"{WAVELENGTHS * speed / experiment.distance:.{_SIGNIFICANT}g}")


def expected_speed(experiment: Experiment, content: float, patterns: int) -> float:
    """Return the median static speed over cement patterns, those of the seeds from 0 on, m/s.

    `ValueError` if a sample has no stiffness.

    Parameters
    ----------
    experiment
        Common settings; its frequencies are ignored.
    content
        Percent of the sand's mass.
    patterns
        Number of patterns; without cement they are all the same.
    """
    # Every configuration imports this module; only a call loads the engine.
    from calcidem.dem.wave.static_speed import static_speed  # noqa: PLC0415

    seeds = range(patterns if content > 0.0 else 1)
    bonded = [experiment.ordering(seed).at(content).bonded for seed in seeds]
    return float(np.median([static_speed(experiment, flags).speed for flags in bonded]))
