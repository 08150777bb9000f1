"""The space-time section of a sample: what its receiver and the stations on the path recorded."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.pulse import Pulse

RESOLUTION = 2.0**-20
"""Step of a recorded velocity over the amplitude of the pulse: 1e-3 of the weakest arrival that is read."""

_LARGEST_COUNT = 2**30
Counts = npt.NDArray[np.int32]


def quantise(velocity: Floats, amplitude: float) -> Counts:
    """Velocities in whole steps of `RESOLUTION`; what is not finite or far above any wave becomes the largest count."""
    steps = np.rint(velocity / (amplitude * RESOLUTION))
    return np.where(np.abs(steps) < _LARGEST_COUNT, steps, _LARGEST_COUNT).astype(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Velocities at places along the path, across the path (y) and along it (x), in whole steps of `RESOLUTION`.

    A live reading sees the same integers as a stored one, so both give the same bits.

    Attributes
    ----------
    sampling_interval
        Time between two samples, s.
    start_time
        Time of the first sample after the pulse began, s.
    frequency
        Of the pulse ``v0 (1 - cos 2 pi f t)``, Hz.
    amplitude
        Its v0, m/s.
    places
        (X,) path from the transmitter to each station, and last to the receiver, m.
    across, along
        (T, X) velocities over ``amplitude * RESOLUTION``, positive as the pulse and away from the transmitter.
    """

    sampling_interval: float
    start_time: float
    frequency: float
    amplitude: float
    places: tuple[float, ...]
    across: Counts
    along: Counts

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
        """Time that has been recorded, s."""
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
        """When the pulse is at its peak, samples."""
        return (0.5 / self.frequency - self.start_time) / self.sampling_interval

    def until(self, samples: int) -> Self:
        """The first samples of it."""
        return replace(self, across=self.across[:samples], along=self.along[:samples])
