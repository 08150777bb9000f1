"""A signal that gave no velocity, as `calcidem.analysis.figures.unread_signal` draws it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class SignalTop:
    """A top of a received signal.

    Attributes
    ----------
    time, height
        s, and in the unit of the signal.
    velocity
        That it would stand for, m/s.
    verdict
        Why it is not read, in words.
    main
        Whether it is the main peak, though in doubt.
    """

    time: float
    height: float
    velocity: float
    verdict: str
    main: bool


@dataclass(frozen=True, slots=True, eq=False)
class UnreadSignal:
    """Signals of a sample without a velocity.

    Attributes
    ----------
    title, reason
        Which sample, and why it has none.
    time
        s, shape (t,).
    sent, received, smooth
        The sent velocity, m/s, and the received signal as it is and as it is searched, in its unit; each (t,).
    sent_peak
        Time of the sent peak, s, from which travel times count.
    distance
        Of the way, m.
    possible
        Slowest and fastest velocity that is read, m/s.
    expected
        Slowest and fastest S wave that is expected, m/s; None without an idea.
    faster
        Least and largest ratio of the velocities of P and S waves.
    tops
        Those that were looked at, from left to right.
    """

    title: str
    reason: str
    time: NDArray[np.float64]
    sent: NDArray[np.float64]
    received: NDArray[np.float64]
    smooth: NDArray[np.float64]
    sent_peak: float
    distance: float
    possible: tuple[float, float]
    expected: tuple[float, float] | None
    faster: tuple[float, float]
    tops: tuple[SignalTop, ...]
