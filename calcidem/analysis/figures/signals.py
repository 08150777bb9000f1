"""Figures of transmitted and received signals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calcidem.analysis.figures.style import (
    BLUE,
    GREEN,
    GREY,
    MS,
    ORANGE,
    VERMILION,
    apply_style,
    letter_panels,
    new_figure,
)

_POINTING = 0.14
METHOD_STYLES = {
    "peak": ("peak to peak", VERMILION, "v"),
    "first_arrival": ("first arrival", GREEN, "o"),
    "cross_correlation": ("cross-correlation", ORANGE, "s"),
}
"""Label, colour and marker of each method of reading; names as in the stored quantities vs_*."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """Signals of one sample and their arrivals."""

    seed: int
    content: float
    """Identity of the sample; content in percent."""
    time: NDArray[np.float64]
    """s, shape (t,)."""
    transmitted: NDArray[np.float64]
    received: NDArray[np.float64]
    """The two signals at these times, shape (t,), m/s."""
    distance: float
    """Distance between transmitter and receiver, m."""
    velocities: Mapping[str, float]
    """Velocity in m/s for the methods of `METHOD_STYLES` that have one."""
    onset: float
    """Level of the first arrival, relative to the peak."""

    @property
    def transmitted_peak(self) -> float:
        """Time of the transmitted peak, s."""
        return float(self.time[np.argmax(self.transmitted)])

    @property
    def transmitted_onset(self) -> float:
        """Time at which the transmitted pulse rises to the onset level, s."""
        peak = int(np.argmax(self.transmitted))
        below = int(np.flatnonzero(self.transmitted[: peak + 1] < self.onset * self.transmitted[peak])[-1])
        return float(self.time[below + 1])

    def arrival_time(self, method: str) -> float:
        """Return the arrival time by a method, s.

        Times count from the transmitted peak, those of the first arrival from the transmitted onset.
        """
        began = self.transmitted_onset if method == "first_arrival" else self.transmitted_peak
        return began + self.distance / self.velocities[method]


def draw_signal_pair(axes: Axes, arrival: Arrival) -> None:
    """Draw both signals of a sample, each over its own peak, and mark the arrivals."""
    time = arrival.time * MS
    axes.axhline(0, color=GREY, linewidth=0.6)
    pulse = arrival.transmitted / np.max(arrival.transmitted)
    axes.fill_between(time, pulse, color=GREY, alpha=0.35, linewidth=0, label="transmitted")
    end = _received_peak_index(arrival)
    largest = np.abs(arrival.received[: end + 1]).max()
    axes.plot(time, arrival.received / largest, color=BLUE, label="received")
    for method, (label, colour, marker) in METHOD_STYLES.items():
        if method not in arrival.velocities:
            continue
        moment = arrival.arrival_time(method)
        # A peak is marked from above, so that the other marks do not hide it.
        level = np.interp(moment, arrival.time, arrival.received / largest) + (_POINTING if method == "peak" else 0)
        axes.plot(
            moment * MS,
            level,
            linestyle="none",
            marker=marker,
            markersize=6,
            color=colour,
            markeredgecolor="white",
            markeredgewidth=0.7,
            zorder=5,
            label=label,
        )
    axes.set_xlim(0, time[-1])
    axes.set_ylim(min(-0.6, 1.1 * float(arrival.received.min()) / largest), 1.35)
    axes.set_ylabel("signal / its peak")


def _received_peak_index(arrival: Arrival) -> int:
    """Index of the received peak; of the last sample without one."""
    if "peak" not in arrival.velocities:
        return len(arrival.time) - 1
    return int(np.searchsorted(arrival.time, arrival.arrival_time("peak")))


@apply_style
def draw_signals(arrivals: Sequence[Arrival]) -> Figure:
    """Draw the signals of samples below one another, from the least to the most cemented, with their arrivals."""
    figure = new_figure(height=0.8 + 1.45 * len(arrivals))
    panels = figure.subplots(len(arrivals), 1, squeeze=False)[:, 0]
    handles: dict[str, Artist] = {}
    for axes, arrival in zip(panels, arrivals, strict=True):
        draw_signal_pair(axes, arrival)
        axes.set_title(f"{arrival.content:g} %, seed {arrival.seed}")
        for line, (method, velocity) in enumerate(arrival.velocities.items()):
            text = f"{METHOD_STYLES[method][0]}:\n{velocity:.0f} m/s"
            axes.text(1.02, 1 - 0.36 * line, text, va="top", fontsize=8, transform=axes.transAxes)
        found, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, found, strict=True))
    letter_panels(panels)
    panels[-1].set_xlabel("time (ms)")
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=len(handles))
    return figure
