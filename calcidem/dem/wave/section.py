"""Space-time section of a sample: records of its receiver and of the stations on the path."""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.pulse import Pulse

RESOLUTION = 2.0**-20
"""Resolution of recorded velocities over the amplitude of the pulse: 1e-3 of the weakest accepted arrival."""

Counts = npt.NDArray[np.int32]


def quantise(velocity: Floats, amplitude: float) -> Counts:
    """Velocities in multiples of `RESOLUTION`; NaN and values far above any wave become the largest count."""
    steps = np.rint(velocity / (amplitude * RESOLUTION))
    # Far above any wave, and half of what int32 holds.
    return np.where(np.abs(steps) < 2**30, steps, 2**30).astype(np.int32)


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
    """See `guards.unbalanced_speed`."""
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
