"""Following the S wave through the sample.

Which top of the received signal does it lead to? Behind a large P wave of opposite sign two tops may be of like height,
and no shape tells which is the S wave. What the disks on the way did tells: their S tops lie on one line through
distance and time, from the transmitter on, and tops that belong to the P wave, or to what swings at the receiver, do
not. The line need not be straight: of all paths whose slowness changes little from station to station, the one with the
highest signals under it is sought by dynamic programming (Bellman 1957).
"""

from dataclasses import dataclass

import numpy as np

from calcidem.dem.kernels.layout import Floats, Integers

_PER_PERIOD = 24  # samples of a period that are enough to follow a top
SLOWER = 1.04  # between one slowness and the next
BEND = 2  # slownesses by which a path may bend at a station
_UNHEARD = 1e-9  # of the largest value; a station with less has not heard anything yet
BEND_COST = 20.0  # score that a bend costs, over the square of the change of log slowness
_COSTS = BEND_COST * np.log(SLOWER) ** 2 * np.arange(BEND + 1) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Ridge:
    """Best paths to some samples of the last station.

    Attributes
    ----------
    scores
        (E,) mean of the signals under each path, each over its station's largest value, less what its bends cost: 1 for
        a path along the highest tops at one slowness.
    places
        (X,) distances of the stations from the transmitter over that of the last.
    begin, step
        Sample at which paths may begin, and samples from one sample of theirs to the next.
    ends
        (E, 3) theirs at which each may end.
    late
        (X, P) travel time to each station at each of P slownesses, in samples of theirs.
    sums
        X arrays (P, T): the largest sum of signals under a path to a sample of a station at a slowness.
    """

    scores: Floats
    places: Floats
    begin: int
    step: int
    ends: Integers
    late: Integers
    sums: tuple[Floats, ...]

    def path_to(self, end: int) -> Integers:
        """(X,) samples at which the path to one of the ends is at the stations."""
        last = self.sums[-1][:, self.ends[end]]
        slowness, column = np.unravel_index(int(np.argmax(last)), last.shape)
        here, samples = int(self.ends[end, column]), []
        bends = np.arange(-BEND, BEND + 1)
        for station in range(len(self.sums) - 1, 0, -1):
            samples.append(here)
            here -= int(self.late[station, slowness] - self.late[station - 1, slowness])
            from_slowness = np.clip(slowness + bends, 0, len(self.late[0]) - 1)
            bent = np.abs(from_slowness - slowness)
            slowness = from_slowness[int(np.argmax(self.sums[station - 1][from_slowness, here] - _COSTS[bent]))]
        return np.asarray(self.begin + self.step * np.array([*samples, here])[::-1])


def follow_ridge(stations: Floats, places: Floats, ends: Integers, sent: float, period: float) -> Ridge:
    """Find the best path from the transmitter through all stations to each of some samples of the last one.

    Parameters
    ----------
    stations
        (T, X) signals on the way, the last of them the receiver's, in any units, as far as may be looked.
    places
        (X,) their distances from the transmitter over that of the last.
    ends
        (E,) samples of the last station, behind the sent peak.
    sent, period
        Time of the sent peak and duration of the sent pulse, in samples.
    """
    step = max(1, int(period / _PER_PERIOD))
    begin = int(sent)
    heights = stations[begin:].max(axis=0)
    heights = np.maximum(heights, max(_UNHEARD * float(heights.max()), np.finfo(float).tiny))
    signals = np.maximum(stations[begin::step] / heights, -1.0)
    count = len(signals)
    travels = [max(1.0, 0.1 * period / step)]  # to the receiver, in samples of these: one for each slowness
    while travels[-1] < count:
        travels.append(travels[-1] * SLOWER)
    late = np.rint(np.outer(places, travels)).astype(int)
    score = np.full((len(travels), count), -np.inf)
    for path, sample in enumerate(late[0]):
        if sample < count:
            score[path, sample] = signals[sample, 0]
    sums = [score]
    for station in range(1, len(places)):
        best = score.copy()
        for bend in range(1, BEND + 1):
            best[:-bend] = np.maximum(best[:-bend], score[bend:] - _COSTS[bend])
            best[bend:] = np.maximum(best[bend:], score[:-bend] - _COSTS[bend])
        before = np.arange(count) - (late[station] - late[station - 1])[:, None]
        came = np.take_along_axis(best, np.maximum(before, 0), axis=1)
        score = np.where(before >= 0, came, -np.inf) + signals[:, station]
        sums.append(score)
    along = score.max(axis=0) / len(places)
    # A path may end a sample beside a top: slownesses and samples are few.
    near = np.rint((np.asarray(ends) - begin) / step).astype(int)[:, None] + np.arange(-1, 2)
    near = np.clip(near, 0, count - 1)
    return Ridge(np.asarray(along[near].max(axis=1)), places, begin, step, near, late, tuple(sums))
