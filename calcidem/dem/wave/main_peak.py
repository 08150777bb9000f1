"""The main peak of a received signal, on which every reading of a travel time leans.

Bare rules fail on real records: the largest value may be a reflection or ringing, and the first one above some level a
precursor (a P wave of the near field) or noise. This search asks of each top in turn what it can be, from the receiver
alone (`peak_alone`) or by what stations saw on the way (`peak_on_ridge`), and looks no further than it has to. The
bounds of both were set on synthetic signals with a known delay (docs/reading.md).
"""

from collections.abc import Iterator

import numpy as np

from calcidem.dem.wave.peak import FASTEST_P, MainPeak, noise_level
from calcidem.dem.wave.peak_alone import judge_alone, least_height_alone
from calcidem.dem.wave.peak_on_ridge import judge_on_ridge, least_height_on_ridge
from calcidem.dem.wave.pick import PassedOver, PickFailure
from calcidem.dem.wave.prepared import PreparedSignals
from calcidem.dem.wave.tops import find_high_tops


def find_main_peak(record: PreparedSignals) -> MainPeak | PickFailure:
    """Find the first top that can be the S wave's, looking no further than its horizon."""
    found = settled_peak(record)
    if found is None or found is PickFailure.TOO_SHORT:
        return _why_no_peak(record, cut_off=found is not None)
    return found


def settled_peak(record: PreparedSignals) -> MainPeak | PickFailure | None:
    """Main peak, or why there is none however the record goes on; None if nothing is there yet.

    `PickFailure.TOO_SHORT` if only a longer record could tell.
    """
    if not np.isfinite(record.received).all():
        return PickFailure.NOT_FINITE
    for _, verdict in judge_tops(record):
        if verdict is PassedOver.TIED:  # what comes later unties nothing
            return PickFailure.LOST
        if not isinstance(verdict, PassedOver):
            return verdict
    return None


def judge_tops(record: PreparedSignals) -> Iterator[tuple[int, MainPeak | PickFailure | PassedOver]]:
    """Sample of each top of a finite record that is above its floor, from left to right, and what the top is.

    The main peak, the reason why it is passed over, or `PickFailure.TOO_SHORT` if only a longer record could tell.
    """
    for index in find_high_tops(record.smooth, record.signals.floor):
        possible = record.earliest < index - record.sent_peak < record.latest
        judge = judge_alone if record.section is None else judge_on_ridge
        yield index, judge(record, index) if possible else PassedOver.OUTSIDE


def least_later_height(record: PreparedSignals) -> float:
    """Height above zero below which a top behind a finite record, which holds the whole pulse, is passed over."""
    offset = abs(float(record.signals.received[0] - record.received[0]))
    known = record.smooth[: max(1, len(record.smooth) - record.reach)]
    least = least_height_alone(record, known) if record.section is None else least_height_on_ridge(known)
    return max(record.signals.floor, least) - offset


def _why_no_peak(record: PreparedSignals, cut_off: bool) -> PickFailure:
    """Tell silence, a record that ends too early, and a record without a clear peak apart."""
    smooth, least = record.smooth, record.signals.floor
    if record.section is None:
        noise = noise_level(record, len(smooth), (int(np.argmax(smooth)) - record.sent_peak) / FASTEST_P)
        least = max(least, record.rule.signal_to_noise * noise)
    if np.abs(smooth).max() <= least:
        return PickFailure.SILENT
    if cut_off or np.argmax(smooth) >= len(smooth) - record.period:
        return PickFailure.TOO_SHORT
    passed_over = () if record.section is None else {why for _, why in judge_tops(record)}
    followed = {PassedOver.OFF_RIDGE, PassedOver.P_WAVE} & set(passed_over)
    return PickFailure.LOST if followed else PickFailure.NO_PEAK
