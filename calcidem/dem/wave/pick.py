"""What a pick of an arrival is: its rule, the signals it reads, its readings, and the reasons why there is none."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np
from annotated_types import Interval, Predicate, Unit

from calcidem.dem.engine.fields import NotNegative, Positive, PositivePart, require, require_fields
from calcidem.dem.kernels.layout import Floats

_PULSE_START = 1e-2  # of the sent peak; a record that starts or ends higher has missed a part of the pulse


class PickFailure(StrEnum):
    """Why a travel time cannot be trusted, in words."""

    NOT_FINITE = "the received signal has values that are not finite"
    SILENT = "nothing above the noise was received"
    TOO_SHORT = "the record ends before the main peak is certain: record for longer"
    NO_PEAK = "no peak stands out of the received signal"
    PRECURSOR = "a swing of opposite sign runs into the main peak and has moved it: send a higher frequency"
    BROAD = "the main peak is so broad that a faster wave may be part of it: send a higher frequency"
    NEAR = "on so short a way P and S wave are one peak: send a higher frequency, or over a longer way"
    UNSURE = "two tops are of nearly the same height, either may be the peak: send another frequency"
    LOST = "the S wave cannot be followed to one top of the received signal: send a higher frequency"
    DISAGREEMENT = "differs by more than a tenth from the peak: read the peak, or send a higher frequency"
    NOISE = "noise hides the first arrival"
    OUTSIDE_WINDOW = "the velocity is outside the window of possible ones"
    UNLIKE = "the received signal does not resemble the sent pulse"


class PassedOver(StrEnum):
    """Why a top of the received signal is not taken for the main peak, in words."""

    OUTSIDE = "its velocity is outside the window of possible ones"
    SMALL = "something more than twice as high comes with it, or soon after"
    LARGER_FOLLOWS = "something larger comes before a slower S wave could be over: it may be a P wave"
    NOT_PROMINENT = "it hardly stands out of what is around it"
    NARROW = "it is far narrower than the pulse that was sent"
    FAINT = "it is hardly above what was there before any wave could be"
    OFF_RIDGE = "what the stations saw on the way leads to another top"
    P_WAVE = "grains moved along the way there as a P wave moves them"
    TIED = "what the stations saw on the way leads to another top as well"


@dataclass(frozen=True, slots=True)
class PickRule:
    """What counts as an arrival.

    Attributes
    ----------
    slowest, fastest
        Window of possible velocities, m/s. What is recorded before the fastest wave is there tells the zero
        line and the noise, so it pays not to set the latter higher than needed.
    prominence
        Smallest prominence of the main peak, relative to its height.
    width
        Smallest width of the main peak at half its prominence, relative to the sent pulse's: grains widen a
        pulse, and what is much narrower is noise.
    precursor
        Swings of opposite sign of this size, relative to a peak, count as the P wave before it.
    horizon
        How far the record is judged, as a multiple of the travel time of a peak, but at least one period
        behind it; or of that of the P wave of opposite sign before it. P waves are 1.3 to 2 times as fast as S waves
        (in a hexagonal lattice
        ``sqrt((3 k_n + k_s) / (k_n + k_s))`` times, 1.4 to 1.5 for k_s / k_n of 1 to 0.86), so a P wave is not taken
        for the larger S wave that is still to come.
    onset
        Level of the first arrival, relative to the peak.
    signal_to_noise
        Smallest ratio of the main peak to the noise, which is what was there before a P wave could be. A peak that
        comes within a period leaves too little of that to tell, and has to be higher still.
    correlation
        Smallest normalised correlation that is still a resemblance.
    smoothing
        Width of the cubic smoothing (Savitzky-Golay, without delay) before peaks are searched for, as a part
        of the sent period.
    fewest_periods
        Shortest travel time that is read, in sent periods: on less, P and S wave are one peak whose time is neither's
        (docs/reading.md, "Near field").
    """

    slowest: Annotated[Positive, Unit("m/s")] = 20.0
    fastest: Annotated[Positive, Unit("m/s")] = 5000.0
    prominence: PositivePart = 0.5
    width: PositivePart = 0.4
    precursor: PositivePart = 0.25
    horizon: Annotated[float, Interval(ge=1.0), Predicate(math.isfinite)] = 2.1
    onset: Annotated[float, Interval(ge=_PULSE_START, lt=1.0)] = 0.1
    signal_to_noise: Annotated[float, Interval(ge=1.0), Predicate(math.isfinite)] = 4.0
    correlation: PositivePart = 0.5
    smoothing: PositivePart = 0.25
    fewest_periods: NotNegative = 0.42

    def __post_init__(self) -> None:
        """Refuse rules that pick nothing or anything."""
        require_fields(self)
        both = f"{self.slowest}, fastest = {self.fastest} m/s"
        require(self.slowest < self.fastest, "slowest", both, "give 0 < slowest < fastest", "fastest")


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """What was sent and what was received.

    Attributes
    ----------
    sampling_interval
        Time between two samples, s. A hundred samples in a period are plenty: picks lie between samples.
    sent
        (S,) velocity of the transmitter, m/s: one positive pulse, from rest to rest.
    received
        (T,) signal of the receiver from the same time on, of any length and in any unit, positive where it
        follows the sent pulse.
    distance
        Between transmitter and receiver, m.
    floor
        Peaks up to this value count as silence, in the unit of ``received``. Give what the receiver does
        without a pulse, or about a thousandth of what is sent: a ripple long before the pulse looks like an
        arrival until the pulse is there, and a simulation also passes on what no instrument would see.
    stations, places
        (T, X) signals on the way, and where, as parts of the distance: they tell which top is the S wave's.
    along
        (T, X + 1) velocities along the way at the stations and at the receiver: they tell P wave from S wave. All other
        signals have to be velocities then.
    """

    sampling_interval: float
    sent: Floats
    received: Floats
    distance: float
    floor: float
    stations: Floats | None = None
    places: tuple[float, ...] = ()
    along: Floats | None = None

    def __post_init__(self) -> None:
        """Refuse signals that do not match or hold no pulse."""
        if not (self.sampling_interval > 0.0 and self.distance > 0.0 and self.floor >= 0.0):
            raise ValueError(
                f"sampling_interval = {self.sampling_interval} s, distance = {self.distance} m, floor = {self.floor}: "
                "give a positive interval and distance, and a floor of 0 or more"
            )
        if np.ndim(self.received) != 1 or np.size(self.received) == 0:
            raise ValueError(f"received {np.shape(self.received)}: give a one-dimensional array of samples")
        if np.ndim(self.sent) != 1 or np.size(self.sent) == 0:
            raise ValueError(f"sent {np.shape(self.sent)}: give a one-dimensional array of samples")
        if self.along is not None and (self.stations is None or self.along.shape[1] != self.stations.shape[1] + 1):
            raise ValueError("along: give stations, too, and a column for each of them and for the receiver")
        if not max(self.sent[0], self.sent[-1]) < _PULSE_START * np.max(self.sent):
            raise ValueError("sent: give one whole positive pulse, which starts and ends at rest")


@dataclass(frozen=True, slots=True)
class Reading:
    """Travel time by one method, or why there is none.

    Attributes
    ----------
    travel_time
        s; None if it cannot be trusted.
    velocity
        Distance over travel time, m/s; None with it.
    quality
        From 0 (no pick) to 1 (beyond doubt); what it measures depends on the method, see `Picks`.
    failure
        None for a trusted pick.
    """

    travel_time: float | None = None
    velocity: float | None = None
    quality: float = 0.0
    failure: PickFailure | None = None


@dataclass(frozen=True, slots=True)
class Picks:
    """Travel time by three methods, which were weighed against one another (docs/reading.md).

    Attributes
    ----------
    peak
        From the peak sent to the main peak received. Quality: how far that peak stands out (its prominence, not
        counting what lies below zero, over the largest value up to the horizon), times how little of its sign
        came before (one less the largest earlier bump over the peak).
    first_arrival
        From the sent to the received signal's last rise through the onset level before their peaks. Using
        the same level on both takes out the delay that a level has. Quality: how little came before.
    cross_correlation
        Lag of the largest correlation of both signals. Quality: the correlation coefficient there, between
        the sent pulse and the part of the record under it.
    """

    peak: Reading
    first_arrival: Reading
    cross_correlation: Reading
