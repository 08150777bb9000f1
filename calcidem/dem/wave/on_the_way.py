"""What the stations say of a doubt about the shape of the main peak.

A P wave that is part of a received peak, or cuts it, has crossed the sample, so that it is at the stations, too. What
only the receiver shows, a swing or a second hump of its own grains, is no wave that came another way.
"""

import numpy as np

from calcidem.dem.kernels.layout import Floats, Integers
from calcidem.dem.wave.pick import PickFailure
from calcidem.dem.wave.tops import falls_through

_FAR = 0.5  # of the way, from where on a swing tells: nearer to the transmitter all waves are one ...
_NOT_NEAR = 0.25  # ... and from where on the width does: a faster wave has already begun to lead there
_NEAR_PATH = 0.2  # periods within which a station's top lies beside the path, whose samples are few
_NO_SWING = 0.08  # of a station's top that comes before it with the other sign, if no P wave does
_NOT_BROAD = 0.08  # of the travel time that a top is broader than the sent one, if no faster wave is part of it, ...
_TOO_BROAD = 0.5  # ... over its part of the way; and the same of a received peak whose own time says little


def denied_doubts(stations: Floats, places: Floats, path: Integers, sent: float, period: float) -> set[PickFailure]:
    """Tell which doubts about a received peak do not hold, by what was on the way.

    Parameters
    ----------
    stations
        (T, X) signals of the stations and of the receiver, as far as may be looked.
    places
        (X,) their distances from the transmitter over that of the receiver.
    path
        (X,) samples at which the S wave that makes the peak was there.
    sent, period
        Time of the sent peak and duration of the sent pulse, in samples.
    """
    asked = [station for station in range(len(places) - 1) if places[station] >= _NOT_NEAR]
    if not asked or places[asked[-1]] < _FAR:
        return set()
    shapes = [_shape_of_top(stations[:, station], int(path[station]), sent, period) for station in asked]
    swings = [swing for station, (swing, _) in zip(asked, shapes, strict=True) if places[station] >= _FAR]
    if np.median(swings) >= _NO_SWING:
        return set()
    # A faster wave that is part of the peak is part of it at each station, and leads by more the further both came.
    as_sent = any(width < _NOT_BROAD * places[station] for station, (_, width) in zip(asked, shapes, strict=True))
    _, width = _shape_of_top(stations[:, -1], int(path[-1]), sent, period)
    return {PickFailure.PRECURSOR, *([PickFailure.BROAD] if as_sent and width < _TOO_BROAD else [])}


def _shape_of_top(view: Floats, near: int, sent: float, period: float) -> tuple[float, float]:
    """Depth before a station's top over its height, and additional width at half of it over its travel time."""
    reach = int(_NEAR_PATH * period)
    begin = max(0, near - reach)
    top = begin + int(np.argmax(view[begin : near + reach + 1]))
    height = float(view[top])
    if height <= 0.0:
        return np.inf, np.inf
    swing, level = -float(view[: top + 1].min()) / height, 0.5 * height
    if max(view[:top].min(initial=np.inf), view[top:].min()) > level:
        return swing, np.inf
    began, ended = falls_through(view, top, level)
    return swing, (ended - began - 0.5 * period) / max(1.0, top - sent)
