"""The main peak without the P wave before it, which moves its top."""

import numpy as np

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.tops import parabola_vertex


def top_without_p(view: Floats, trough: int, index: int) -> float:
    """Time of the peak once the P wave before it is taken off.

    What leads a P wave is free of the S wave, and what trails an S wave free of the P wave. With pulses that are the
    same before and after their tops, each is its free half and the mirror image of that, taken off the record in turn.
    """
    trailing: Floats = np.zeros(len(view))
    for _ in range(2):
        rest = view - trailing
        trough = int(np.argmin(rest[: index + 1]))
        alone = view + _mirrored(-rest, trough)
        # From the top that was: a large P wave that is not symmetric leaves larger ones near its own.
        index = _nearest_top(alone, trough, index)
        trailing = _mirrored(alone[::-1], len(view) - 1 - index)[::-1]
    return index + (parabola_vertex(alone, index) if 0 < index < len(alone) - 1 else 0.0)


def _nearest_top(view: Floats, begin: int, index: int) -> int:
    """Sample of the top that is reached from one sample by climbing, to the next one or back to ``begin`` at most."""
    if view[index + 1] > view[index]:
        return index + 1
    rising = np.flatnonzero(np.diff(view[begin : index + 1]) > 0.0)
    return begin + (int(rising[-1]) + 1 if len(rising) else 0)


def _mirrored(signal: Floats, top: int) -> Floats:
    """Pulse that is the lobe of a signal before a top, and its mirror image behind it."""
    reach = min(top, len(signal) - 1 - top)
    below = np.flatnonzero(signal[top - reach : top] <= 0.0)
    begin = top - reach + (int(below[-1]) + 1 if len(below) else 0)
    pulse, lobe = np.zeros(len(signal)), signal[begin : top + 1]
    pulse[begin : top + 1] = lobe
    pulse[top : 2 * top - begin + 1] = lobe[::-1]
    return pulse
