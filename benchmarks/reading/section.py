"""A space-time section with a known delay, as both generators give it to a judge, and a file for many of them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from calcidem.dem.kernels.layout import Flags, Floats
from calcidem.dem.wave.pulse import Pulse


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


_SCALARS = tuple(
    entry.name for entry in fields(Section) if entry.name not in {"kind", "times", "places", "across", "along"}
)


def save_sections(path: Path, sections: Sequence[Section]) -> None:
    """Write sections to an uncompressed .npz file; signals are kept in single precision."""
    signals = [np.concatenate([one.across.ravel(), one.along.ravel()]) for one in sections]
    np.savez(
        path,
        kind=np.array([one.kind for one in sections]),
        first_time=np.array([one.times[0] for one in sections]),
        interval=np.array([one.times[1] - one.times[0] for one in sections]),
        samples=np.array([len(one.times) for one in sections]),
        columns=np.array([len(one.places) for one in sections]),
        places=np.concatenate([one.places for one in sections]),
        signals=np.concatenate(signals).astype(np.float32),
        **{name: np.array([getattr(one, name) for one in sections]) for name in _SCALARS},
    )


def load_sections(path: Path) -> list[Section]:
    """Sections of a file that `save_sections` has written."""
    with np.load(path) as stored:
        data = {name: stored[name] for name in stored.files}
    sections, signal, place = [], 0, 0
    for index in range(len(data["kind"])):
        samples, columns = int(data["samples"][index]), int(data["columns"][index])
        size = samples * columns
        across, along = data["signals"][signal : signal + 2 * size].astype(float).reshape(2, columns, samples)
        scalars = {name: data[name][index].item() for name in _SCALARS}
        times = data["first_time"][index] + data["interval"][index] * np.arange(samples)
        places = data["places"][place : place + columns]
        sections.append(
            Section(str(data["kind"][index]), times=times, places=places, across=across, along=along, **scalars)
        )
        signal, place = signal + 2 * size, place + columns
    return sections


def peak_time(times: Floats, signal: Floats, inside: Flags) -> float:
    """Time of the largest value among some samples, between samples by a parabola; NaN where it is no peak."""
    top = int(np.flatnonzero(inside)[np.argmax(signal[inside])])
    if not 0 < top < len(signal) - 1 or max(signal[top - 1], signal[top + 1]) > signal[top]:
        return float("nan")
    left, middle, right = signal[top - 1 : top + 2]
    curvature = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
    return float(times[top] + shift * (times[1] - times[0]))


def kinds_of(sections: Iterable[Section]) -> tuple[str, ...]:
    """Kinds in the order in which they come."""
    return tuple(dict.fromkeys(one.kind for one in sections))
