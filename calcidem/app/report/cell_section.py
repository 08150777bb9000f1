"""The section of a cell as the page draws it: coarse traces, and the lines of the peaks that may be the S wave."""

from typing import Any

import numpy as np

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.app.campaign.patterns import section_of
from calcidem.dem.wave.reading import LEAST_COHERENCE, PickRule, find_candidates
from calcidem.storage.records import CellResult, RecordedSection

_MOST_TIMES = 90
_TRACE_LEVELS = 40
"""Times at which a trace is kept, and steps from zero to its largest value: finer than the lines of the drawing."""

_MOST_PEAKS = 5
"""Peaks that are shown, the most coherent ones."""

_SAME = 1e-3  # of a travel time, by which a peak is that of the stored velocity


def describe_section(analysis: CampaignAnalysis, cell: CellResult, stored: RecordedSection) -> dict[str, Any]:
    """Give the motion across the path without the P wave at each place, in steps between levels, and the peaks.

    Times are in milliseconds, places in millimetres.
    """
    section = section_of(stored)
    smoothing = analysis.config.get("pick", {}).get("smoothing", PickRule().smoothing)
    candidates = find_candidates(section, smoothing)
    travel = None if cell.vs_peak is None else section.distance / cell.vs_peak
    chosen = [one for one in candidates if travel is not None and abs(one.travel_time / travel - 1.0) < _SAME]
    motion = np.asarray(section.across, dtype=float)
    if chosen:  # nothing later decides
        motion = chosen[0].clean[: max(2, round(chosen[0].decided / section.sampling_interval))]
    elif candidates:
        motion = max(candidates, key=lambda one: one.coherence).clean
    stride = -(-len(motion) // _MOST_TIMES)
    traces = motion[::stride]
    largest = np.abs(traces).max(axis=0, initial=0.0)
    levels = np.rint(traces / np.where(largest > 0.0, largest, 1.0) * _TRACE_LEVELS).astype(int)
    ranked = sorted(candidates, key=lambda one: (one not in chosen, -one.coherence))[:_MOST_PEAKS]
    return {
        "start": round(1e3 * section.start_time, 6),
        "interval": float(f"{1e3 * stride * section.sampling_interval:.6g}"),
        "levels": _TRACE_LEVELS,
        "places": [round(1e3 * place, 2) for place in section.places],
        "traces": np.diff(levels, axis=0, prepend=0).T.tolist(),
        "begin": float(f"{0.5e3 / section.frequency:.6g}"),
        "least": LEAST_COHERENCE,
        "peaks": [
            [float(f"{1e3 * one.travel_time:.5g}"), round(one.coherence, 2), int(one in chosen)]
            for one in sorted(ranked, key=lambda one: one.travel_time)
        ],
    }
