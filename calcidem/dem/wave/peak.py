"""What a main peak is, and what about its shape lets its time be doubted."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.pick import PickFailure
from calcidem.dem.wave.prepared import PreparedSignals
from calcidem.dem.wave.tops import find_tops, half_height, half_width, prominence

FASTEST_P = 2.2
"""Speed over that of the S wave; before such a wave there is nothing but noise."""

ENOUGH = 0.5
"""Of the largest value; behind a P wave of opposite sign, or before ringing, the first such top is read."""

APART = 0.05
"""Of the travel time; tops that are nearer to each other do not make a velocity wrong."""

BLURRED = 1.4
"""Periods on the way; in records with fewer a faster wave may be part of a peak."""

CUTTING = 1.6
"""Periods on the way; in records with fewer a P wave may cut a peak."""

PERIODS_ASKED = {PickFailure.BROAD: BLURRED, PickFailure.NEAR: BLURRED, PickFailure.PRECURSOR: CUTTING}
"""Periods of the pulse on the way from which on these reasons do not occur, or mostly not."""

_BLUR = 0.14  # of the travel time that the additional width of a peak may be ...
_BLUR_BEFORE = 0.06  # ... and that of its rising half alone
_FEWEST_PERIODS = 0.75  # on the way; with fewer, a faster wave need not begin much earlier
_SHIFT = 0.05  # of the travel time by which a P wave of opposite sign may have moved the peak
_LEAN = 0.05  # periods by which a peak may be steeper before its top, or a P wave has cut it
_CUTTING_ON_RIDGE = 1.85  # as CUTTING, where stations tell which top it is, and nothing else is asked of it
_BLUR_ON_RIDGE = 0.22  # as _BLUR, where stations tell which top it is: it may be one wave that took several ways
_LEAN_ON_RIDGE = 0.15  # periods by which a broad peak on the ridge is longer before its top, if it is one wave


@dataclass(frozen=True, slots=True)
class MainPeak:
    """Main peak of a record.

    Attributes
    ----------
    index, time
        Its sample, and its time in samples; behind a P wave of opposite sign that of the peak without that wave.
    height, noise
        In the unit of the received signal.
    precursor
        Largest earlier bump of the same sign over the height.
    quality
        See `Picks`.
    doubt
        Why its time cannot be trusted; None if it can.
    end
        Number of samples on which all this, and every other reading, depends.
    """

    index: int
    time: float
    height: float
    noise: float
    precursor: float
    quality: float
    doubt: PickFailure | None
    end: int


def doubts_about(
    record: PreparedSignals, view: Floats, index: int, time: float, *, behind_p: bool
) -> Iterator[PickFailure]:
    """Tell why the time of a main peak, or without its P wave, would be chance."""
    travel, alone = index - record.sent_peak, record.section is None
    lean = _lean(view, index) / record.period
    # On the ridge a peak that is longer before its top is one S wave that took several ways, and not cut by another.
    if travel < BLURRED * record.period and _is_broad(record, view, index) and (alone or lean > -_LEAN_ON_RIDGE):
        yield PickFailure.BROAD
    cut = travel < (CUTTING if alone else _CUTTING_ON_RIDGE) * record.period and lean > _LEAN
    if behind_p and (cut or index - time > _SHIFT * travel):
        yield PickFailure.PRECURSOR
    if travel < record.rule.fewest_periods * record.period:
        yield PickFailure.NEAR


def largest_bump(before: Floats) -> float:
    """Largest prominence of the tops in a part of a signal; 0 if it has none."""
    return max((prominence(before, top) for top in find_tops(before).tolist()), default=0.0)


def _lean(view: Floats, index: int) -> int:
    """Samples by which a peak is longer behind its top than before it, at half its height."""
    before, behind = half_height(view, index)
    return behind - before - 1


def _is_broad(record: PreparedSignals, view: Floats, index: int) -> bool:
    """Whether a faster wave may be part of a peak: it began too early, and not only ended late."""
    began, ended = half_width(view, index)
    travel = index - record.sent_peak
    before = index - began - record.period / 4.0
    blur = _BLUR if record.section is None else _BLUR_ON_RIDGE
    wide = ended - began - record.period / 2.0 > blur * travel
    return wide and (before > _BLUR_BEFORE * travel or travel < _FEWEST_PERIODS * record.period)


def noise_level(record: PreparedSignals, horizon: int, quiet: float) -> float:
    """Return the larger of what was there in the first samples, and of what smoothing takes away (rms)."""
    swing = np.abs(record.smooth[: max(1, int(max(quiet, record.earliest)))]).max()
    rough = np.std(record.received[:horizon] - record.smooth[:horizon])
    return float(max(swing, rough))
