"""Transmitted pulse: its shape, and its frequency for a calcite content."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.portable import interpolate, sine_of_turns
from calcidem.dem.kernels.layout import Floats

EXCITATION = (
    (0.0, 4.0e3),
    (0.11, 4.0e3),
    (0.23, 5.0e3),
    (0.34, 7.0e3),
    (0.45, 8.0e3),
    (0.55, 8.0e3),
    (0.66, 8.0e3),
    (1.24, 8.0e3),
    (1.88, 8.0e3),
    (2.55, 8.0e3),
    (3.17, 8.0e3),
    (4.0, 10.0e3),
    (5.0, 15.0e3),
    (6.0, 20.0e3),
    (7.0, 25.0e3),
    (8.0, 25.0e3),
    (9.0, 25.0e3),
)
"""Table 2 of the paper: calcite content, percent of the sand's mass, and excitation frequency, Hz."""


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
    def duration(self) -> float:
        """One period, s."""
        return 1.0 / self.frequency

    @property
    def peak_time(self) -> float:
        """Time of the largest velocity, 1 / (2 f), s."""
        return 0.5 / self.frequency

    @property
    def stroke(self) -> float:
        """Displacement that remains after the pulse, v0 / f, m."""
        return self.amplitude / self.frequency

    def velocity(self, time: npt.ArrayLike) -> Floats:
        """Return the velocity at times (s, any shape), m/s; zero before 0 and after one period."""
        cycle = np.clip(self.frequency * np.asarray(time, dtype=float), 0.0, 1.0)
        return np.asarray(self.amplitude * (2.0 * sine_of_turns(0.5 * cycle) ** 2))

    def displacement(self, time: npt.ArrayLike) -> Floats:
        """Return the displacement since time 0 at times (s, any shape), m: the integral of the velocity."""
        cycle = np.clip(self.frequency * np.asarray(time, dtype=float), 0.0, 1.0)
        return np.asarray(self.stroke * (cycle - sine_of_turns(cycle) / (2.0 * np.pi)))


def excitation_frequency(content: float) -> float:
    """Return the excitation frequency for a calcite content (percent), Hz.

    The paper's values (`EXCITATION`), interpolated linearly between its contents.

    Raises
    ------
    ValueError
        Outside the contents of Table 2, where a guess could exceed the cut-off frequency.
    """
    contents, frequencies = zip(*EXCITATION, strict=True)
    if not contents[0] <= content <= contents[-1]:
        raise ValueError(
            f"content = {content} %: Table 2 has frequencies from {contents[0]:g} to {contents[-1]:g} %; "
            "give the frequency for this content"
        )
    return interpolate(content, contents, frequencies)


def cutoff_frequency(stiffness: float, mass: float) -> float:
    """Cut-off frequency of a chain of grains, Hz.

    Parameters
    ----------
    stiffness
        Contact stiffness in the direction of the motion, N/m.
    mass
        Mass of a grain, kg.

    Notes
    -----
    The highest frequency of a chain is ``omega = 2 sqrt(k / m)`` (L. Brillouin, Wave Propagation in Periodic
    Structures, 1946), so ``f = sqrt(k / m) / pi``. Its long waves have the speed ``V = d sqrt(k / m)`` for a spacing d,
    so ``f = V / (pi d)``.
    """
    if not (stiffness > 0.0 and mass > 0.0):
        raise ValueError(f"stiffness = {stiffness} N/m, mass = {mass} kg: give positive numbers")
    return float(np.sqrt(stiffness / mass) / np.pi)
