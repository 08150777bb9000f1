"""Telling P wave from S wave by the way the grains move.

The P wave comes first and moves grains along its way, the S wave across it. Where cement is uneven the P wave does not
come straight, so that a part of its motion is across, too, and looks like an S wave that comes early. That part follows
the motion along: as seismologists turn the axes of a station into the direction of what comes first (polarisation
analysis: Montalbetti and Kanasewich 1970, doi:10.1111/j.1365-246X.1970.tb01771.x), its share is found at each station
from the first swing along the way, and as much of that swing is taken off. What is left of P waves moves along still.
"""

import numpy as np

from calcidem.dem.kernels.layout import Flags, Floats, Integers
from calcidem.dem.wave.tops import find_tops

FAINTEST = 0.01
"""Of the sent peak: motion along the way that may be the beginning of a P wave."""

STEEPEST = 0.5
"""Largest motion across over that along which a P wave is taken to have: it comes at 27 degrees to the way."""

_SOON = 1.0  # periods within which ...
_LARGER = 3.0  # ... nothing this many times as large follows the first swing: that would be the P wave
_UNACCOMPANIED = 0.05  # of the sent peak; motion across that comes without any along is no P wave


def find_p_waves(across: Floats, along: Floats, lasting: int, sent: float, period: float) -> tuple[Floats, Flags]:
    """Motion across that belongs to the P wave's first swing, at each station.

    Parameters
    ----------
    across, along
        (T, X) velocities of the stations.
    lasting
        Number of samples of them that are the same in a longer record.
    sent
        Peak of what was sent, in their unit.
    period
        Duration of the sent pulse, in samples.

    Returns
    -------
    shares
        (T, X) motion across over that along, by least squares over what came up to the top of the first swing, within
        `STEEPEST`, until that swing is over; 0 from then on, and where something came across before.
    known
        (X,) false where a longer record may give other ones.
    """
    shares, known = np.zeros_like(along), np.zeros(along.shape[1], dtype=bool)
    for station, columns in enumerate(zip(across[:lasting].T, along[:lasting].T, strict=True)):
        found = _first_swing(*columns, sent, period)
        if found is not None:
            share, end = found
            known[station] = end < lasting
            shares[: end if end < lasting else None, station] = share
    return shares, known


def _first_swing(across: Floats, along: Floats, sent: float, period: float) -> tuple[float, int] | None:
    """Share of the first swing at one station and the sample where it is over; None if it cannot be told yet."""
    swing, lone = np.abs(along), np.abs(across) > _UNACCOMPANIED * sent
    heard = swing > FAINTEST * sent
    begin = int(heard.argmax()) if heard.any() else len(swing)
    if lone[:begin].any():
        return 0.0, 0
    for top in find_tops(swing).tolist():
        soon = top + int(_SOON * period)
        if top < begin or swing[top:soon].max() > _LARGER * swing[top]:
            continue
        if soon > len(swing):
            return None
        x, y = along[: top + 1], across[: top + 1]
        share = float(np.clip(np.sum(x * y) / np.sum(x * x), -STEEPEST, STEEPEST))
        other = along[top:] * along[top] <= 0.0
        return share, top + int(other.argmax()) if other.any() else len(along)
    return None


def along_over_across(across: Floats, along: Floats, path: Integers, reach: int) -> Floats:
    """(X,) motion along the way over that across it, by their rms within so many samples (``reach``) of a path (X,)."""

    def strength(signals: Floats) -> Floats:
        rows = np.clip(path + np.arange(-reach, reach + 1)[:, None], 0, len(signals) - 1)
        return np.asarray(np.sqrt(np.mean(signals[rows, np.arange(len(path))] ** 2, axis=0)))

    return strength(along) / np.maximum(strength(across), np.finfo(float).tiny)
