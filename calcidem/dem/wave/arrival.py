"""Reading the travel time of a pulse from what was sent and what was received.

Three methods of reading bender elements (section 3.1.1 of the paper; Viggiani and Atkinson 1995,
doi:10.1680/geot.1995.45.1.149): from peak to peak, by first arrival, and by cross-correlation. All lean on one search
for the main peak, see `main_peak`, so a simulation that stops when `is_settled` says so gives the same readings, to the
last bit, as one that goes on.
"""

import numpy as np

from calcidem.dem.engine.portable import sliding_products
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.main_peak import find_main_peak, least_later_height, settled_peak
from calcidem.dem.wave.peak import MainPeak
from calcidem.dem.wave.pick import PickFailure, PickRule, Picks, Reading, Signals
from calcidem.dem.wave.polarisation import FAINTEST, STEEPEST
from calcidem.dem.wave.prepared import PreparedSignals, prepare_signals
from calcidem.dem.wave.tops import parabola_vertex

_PULSE_FLOOR = 1e-6  # of the sent peak; less is taken for rest
_DISAGREEMENT = 0.1  # of the travel time
_DEFAULT_RULE = PickRule()


def read_travel_times(signals: Signals, rule: PickRule = _DEFAULT_RULE) -> Picks:
    """Read the travel time of a pulse by three methods.

    Without a trusted main peak all three readings fail, for the same reason. First arrival and correlation fail where
    they differ from the peak by more than a tenth: on signals with a known delay the peak was then right five times of
    six, also where both others agreed (docs/reading.md).
    """
    record = prepare_signals(signals, rule)
    main = find_main_peak(record)
    failure = main if isinstance(main, PickFailure) else main.doubt
    if isinstance(main, PickFailure) or failure is not None:
        return Picks(*[Reading(failure=failure)] * 3)
    peak = _read_peak(record, main)
    others = _read_first_arrival(record, main), _read_cross_correlation(record, main)
    return Picks(peak, *(_weigh_against_peak(other, peak) for other in others))


def _weigh_against_peak(other: Reading, peak: Reading) -> Reading:
    """Drop a reading that differs from the peak."""
    if other.travel_time is None or peak.travel_time is None:
        return other
    differs = abs(other.travel_time - peak.travel_time) > _DISAGREEMENT * peak.travel_time
    return Reading(failure=PickFailure.DISAGREEMENT) if differs else other


def is_settled(signals: Signals, rule: PickRule = _DEFAULT_RULE, *, loudest: float = np.inf) -> bool:
    """Return whether a longer record of this sample changes no reading.

    Either the main peak is there, trusted or not, or there is none, and what is received from now on, ``loudest`` at
    most, is too low to be it.
    """
    record = prepare_signals(signals, rule)
    if not record.along_known and loudest >= FAINTEST * float(np.max(signals.sent)):
        return False
    main = settled_peak(record)
    if main is not None:
        return isinstance(main, MainPeak) or main is PickFailure.LOST
    height, open_end = least_later_height(record), np.asarray(signals.received)[-1 - record.reach :]
    # Motion across and along, of which the latter may be taken off the former, are one disk's velocity.
    loudest *= 1.0 if record.along is None else float(np.hypot(1.0, STEEPEST))
    return loudest < height and float(np.abs(open_end).max()) < height


def record_duration(distance: float, velocity: float, frequency: float, rule: PickRule = _DEFAULT_RULE) -> float:
    """Return the length of record, s, in which a pulse without dispersion is settled; SI units."""
    travel, period = distance / velocity, 1.0 / frequency
    return 0.5 * period + travel + max((rule.horizon - 1.0) * travel, period) + rule.smoothing * period


def _read_peak(record: PreparedSignals, main: MainPeak) -> Reading:
    """Read the time between both peaks."""
    return record.reading(main.time - record.sent_peak, main.quality)


def _read_first_arrival(record: PreparedSignals, main: MainPeak) -> Reading:
    """Read the time between the last rises through the onset level before both peaks."""
    onset, sent = record.rule.onset, record.sent
    if main.noise >= onset * main.height:
        return Reading(failure=PickFailure.NOISE)
    began = _last_rise(sent, record.sent_top, onset * float(sent[record.sent_top]))
    ended = _last_rise(record.smooth, main.index, onset * main.height)
    return record.reading(ended - began, 1.0 - main.precursor)


def _read_cross_correlation(record: PreparedSignals, main: MainPeak) -> Reading:
    """Read the lag at which the sent pulse fits the received signal best."""
    sent, received = record.sent, record.received[: main.end]
    support = np.flatnonzero(np.abs(sent) > _PULSE_FLOOR * sent[record.sent_top])
    begin = int(support[0])
    pulse = sent[begin : int(support[-1]) + 1]
    if len(pulse) > len(received):
        return Reading(failure=PickFailure.TOO_SHORT)
    products = sliding_products(received, pulse)
    best = int(np.argmax(products))
    if not 0 < best < len(products) - 1:
        return Reading(failure=PickFailure.OUTSIDE_WINDOW)
    energy = np.sum(pulse**2) * np.sum(received[best : best + len(pulse)] ** 2)
    coefficient = min(1.0, float(products[best] / np.sqrt(energy)))
    if coefficient < record.rule.correlation:
        return Reading(failure=PickFailure.UNLIKE)
    return record.reading(best + parabola_vertex(products, best) - begin, coefficient)


def _last_rise(signal: Floats, top: int, level: float) -> float:
    """Return the time in samples at which a signal last rises through a level before its peak."""
    below = int(np.flatnonzero(signal[: top + 1] < level)[-1])
    low, high = signal[below], signal[below + 1]
    return below + float((level - low) / (high - low))
