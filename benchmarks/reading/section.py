"""A space-time section with a known delay, as the generator gives it to a judge."""

from dataclasses import dataclass

import numpy as np

from calcidem.dem.kernels.layout import Flags, Floats
from calcidem.dem.wave.section import Pulse


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Motion at stations and at the receiver, and the delay of the S wave that a reading is to find.

    Attributes
    ----------
    kind
        Medium or mixture of waves that it was drawn from.
    group
        Simulation that it comes from; sections of one group are not independent.
    times
        (T,) evenly spaced, s.
    places
        (X + 1,) distance of the stations and, last, of the receiver from the transmitter, over `distance`.
    across, along
        (X + 1, T) velocity normal to the path, in which the transmitter moves, and along the path, m/s.
    distance
        From transmitter to receiver, m.
    amplitude, frequency
        Of the transmitted pulse ``v0 (1 - cos 2 pi f t)``, m/s and Hz.
    delay
        From the transmitted peak to that of the plane S wave at the receiver, s.
    delay_error
        Relative uncertainty of ``delay``.
    aperture
        Half-height of the transmitter over the wavelength; infinite for a plane wave.
    clamp
        K of the strip between damped layers, 1/m (`calcidem.dem.wave.section`); 0 without layers.
    readable
        Whether the largest value up to 1.5 delays is a peak within 5 % of the known delay, without the noise, and the
        noise is less than a tenth of it.
    """

    kind: str
    group: int
    times: Floats
    places: Floats
    across: Floats
    along: Floats
    distance: float
    amplitude: float
    frequency: float
    delay: float
    delay_error: float
    aperture: float
    clamp: float
    readable: bool

    @property
    def transmitted(self) -> Floats:
        """(T,) velocity of the transmitter, m/s."""
        return Pulse(self.amplitude, self.frequency).velocity(self.times)

    @property
    def transmitted_peak(self) -> float:
        """Time of the transmitted peak, s."""
        return 0.5 / self.frequency

    @property
    def velocity(self) -> float:
        """Known velocity, m/s."""
        return self.distance / self.delay

    @property
    def wavelengths(self) -> float:
        """Path over wavelength."""
        return self.frequency * self.delay


def peak_time(times: Floats, signal: Floats, inside: Flags) -> float:
    """Time of the largest value among some samples, between samples by a parabola; NaN where it is no peak."""
    top = int(np.flatnonzero(inside)[np.argmax(signal[inside])])
    if not 0 < top < len(signal) - 1 or max(signal[top - 1], signal[top + 1]) > signal[top]:
        return float("nan")
    left, middle, right = signal[top - 1 : top + 2]
    curvature = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
    return float(times[top] + shift * (times[1] - times[0]))
