"""Figures of transmitted and received signals, and of the dispersion that they show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError
from calcidem.analysis.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    KHZ,
    MS,
    ORANGE,
    VERMILION,
    apply_style,
    letter_panels,
    new_figure,
    pick_evenly,
)
from calcidem.analysis.velocity import ContentDispersion
from calcidem.storage.errors import UnknownCellError
from calcidem.storage.records import CellResult

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

    @property
    def transmitted_peak(self) -> float:
        """Time of the transmitted peak, s."""
        return float(self.time[np.argmax(self.transmitted)])

    @property
    def transmitted_onset(self) -> float:
        """Time at which the transmitted pulse rises to a tenth of its peak, the level of the first arrival, s."""
        peak = int(np.argmax(self.transmitted))
        below = int(np.flatnonzero(self.transmitted[: peak + 1] < 0.1 * self.transmitted[peak])[-1])
        return float(self.time[below + 1])

    def arrival_time(self, method: str) -> float:
        """Return the arrival time by a method, s.

        Times count from the transmitted peak, those of the first arrival from the transmitted onset.
        """
        began = self.transmitted_onset if method == "first_arrival" else self.transmitted_peak
        return began + self.distance / self.velocities[method]


def load_arrival(analysis: CampaignAnalysis, seed: int, content: float) -> Arrival:
    """Return the signals of a sample and their arrivals; `UnavailableError` if it or its section is not stored."""
    try:
        return read_arrival(analysis, analysis.cell(seed, content))
    except UnknownCellError as error:
        raise UnavailableError(str(error)) from error


def read_arrival(analysis: CampaignAnalysis, cell: CellResult) -> Arrival:
    """Return the signals of a cell and their arrivals; `UnavailableError` if no section is stored."""
    section = cell.section
    if section is None:
        raise UnavailableError(f"no section is stored for seed {cell.key.seed} at {cell.key.content:g} %")
    velocities = {name: getattr(cell, f"vs_{name}") for name in METHOD_STYLES}
    return Arrival(
        seed=cell.key.seed,
        content=cell.key.content,
        time=section.time,
        transmitted=section.transmitted,
        received=section.received,
        # A cell whose path is the whole width has no distance.
        distance=cell.distance or analysis.store.packing(cell.packing_index).width,
        velocities={name: value for name, value in velocities.items() if value is not None},
    )


def draw_signal_pair(axes: Axes, arrival: Arrival) -> None:
    """Draw both signals of a sample, each over its own peak, and mark the arrivals."""
    time = arrival.time * MS
    axes.axhline(0, color=GREY, linewidth=0.6)
    pulse = arrival.transmitted / np.max(arrival.transmitted)
    axes.fill_between(time, pulse, color=GREY, alpha=0.35, linewidth=0, label="transmitted")
    seen = np.searchsorted(arrival.time, arrival.arrival_time("peak")) if "peak" in arrival.velocities else time.size
    largest = np.abs(arrival.received[: seen + 1]).max()
    axes.plot(time, arrival.received / largest, color=BLUE, label="received")
    for method, (label, colour, marker) in METHOD_STYLES.items():
        if method not in arrival.velocities:
            continue
        moment = arrival.arrival_time(method)
        # A peak is marked from above, so that the other marks do not hide it.
        level = np.interp(moment, arrival.time, arrival.received / largest) + (0.14 if method == "peak" else 0.0)
        look: dict[str, Any] = {"markersize": 6, "color": colour, "markeredgecolor": "white", "markeredgewidth": 0.7}
        axes.plot(moment * MS, level, marker, zorder=5, label=label, **look)
    axes.set_xlim(0, time[-1])
    axes.set_ylim(min(-0.6, 1.1 * float(arrival.received.min()) / largest), 1.35)
    axes.set_ylabel("signal / its peak")


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


@apply_style
def draw_dispersion(contents: Sequence[ContentDispersion]) -> Figure:
    """Draw power over frequency and phase velocity, the phase velocity with its error, and the long-wave limit.

    At most six contents are shown.
    """
    contents = pick_evenly(contents, 6)
    lines = -(-len(contents) // 2)
    figure = new_figure(height=0.7 + 2.1 * lines)
    panels = figure.subplots(lines, 2, squeeze=False).ravel()
    for axes, shown in zip(panels, contents, strict=False):
        _draw_content_dispersion(axes, shown)
    label = "power of plane waves (1: all stations in phase)"
    figure.colorbar(panels[0].collections[0], ax=panels.tolist(), label=label, aspect=40, pad=0.01)
    letter_panels(panels[: len(contents)])
    for axes in panels[len(contents) :]:
        axes.set_axis_off()
    figure.supxlabel("frequency (kHz)", fontsize=9)
    figure.supylabel("phase velocity (m/s)", fontsize=9)
    labelled = max((axes.get_legend_handles_labels() for axes in panels), key=lambda found: len(found[1]))
    figure.legend(*labelled, loc="outside upper center", ncols=2)
    return figure


def _draw_content_dispersion(axes: Axes, shown: ContentDispersion) -> None:
    """Draw the spectrum of one content and its dispersion."""
    found = shown.found
    # A ridge of stations in random phases has less power. As of a cell, a velocity has an error of at most a quarter.
    known = (found.power.max(axis=1) > 0.3) & ~(found.standard_error > 0.25 * found.phase_velocity)
    ridge = np.where(known, found.phase_velocity, np.nan)
    axes.grid(visible=False)
    axes.pcolormesh(
        found.frequency * KHZ, found.velocity, found.power.T, cmap="Blues", vmin=0.0, vmax=1.0, rasterized=True
    )
    axes.errorbar(
        found.frequency * KHZ,
        ridge,
        yerr=found.standard_error,
        fmt="o-",
        color=BLACK,
        markersize=2.5,
        linewidth=0.8,
        label="phase velocity and its standard error",
    )
    axes.errorbar(
        [0.0],
        [found.long_wave],
        yerr=[found.long_wave_error],
        fmt="D",
        color=VERMILION,
        markersize=4.5,
        capsize=2,
        clip_on=False,
        zorder=5,
        label="long-wave limit",
    )
    axes.axhline(shown.vs, color=VERMILION, linewidth=0.9, linestyle=":", label="median Vs")
    if np.isfinite(shown.static):
        axes.axhline(shown.static, color=GREEN, linewidth=0.9, linestyle="--", label="static speed (median)")
    ends = (found.phase_velocity + np.outer([-1.0, 1.0], found.standard_error))[:, known]
    reached = [*ends[np.isfinite(ends)], found.long_wave, shown.vs]
    axes.set_ylim(min(0.45 * shown.vs, 0.9 * min(reached)), max(2.2 * shown.vs, 1.1 * max(reached)))
    axes.set_xlim(0.0, (found.frequency[-1] + 0.5 * (found.frequency[-1] - found.frequency[-2])) * KHZ)
    axes.set_title(f"{shown.content:g} % ({found.samples} sample{'s' * (found.samples != 1)})")
