"""Picture of a space-time section: what the stations recorded, and the lines along which it was stacked."""

import textwrap
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calcidem.analysis.figures.style import (
    BLACK,
    BLUE,
    GREY,
    MM,
    MS,
    ORANGE,
    SKY,
    VERMILION,
    apply_style,
    letter_panels,
    new_figure,
)

_Array: TypeAlias = NDArray[np.floating[Any]]
_MOST_LINES = 6  # candidates that are shown, the most coherent ones
_EXCURSION = 0.75  # largest value of a trace over the mean distance of the stations
_CHARACTERS = 100  # in a line of text


@dataclass(frozen=True, slots=True, eq=False)
class SectionPicture:
    """A section and its reading.

    Attributes
    ----------
    title, text
        Name of the sample, and the line below it.
    times, places
        (T,) s and (X,) m, the last place is the receiver.
    across, clean
        (T, X) motion across the path, as smoothed and without the P wave, over v0.
    p_waves
        (X,) when the first swing of the P wave peaks, s; NaN where none was found.
    transmitted_peak
        s.
    candidates
        Travel times (s) and coherences of the receiver's peaks.
    chosen
        Which of them is the S wave; None if none is.
    velocities, spectrum
        (V,) m/s, and the stack of the section at each.
    least_coherence
        Smallest stack of an S wave.
    expected
        Slowest and fastest S wave that is expected, m/s; None if that is not known.
    """

    title: str
    text: str
    times: _Array
    places: _Array
    across: _Array
    clean: _Array
    p_waves: _Array
    transmitted_peak: float
    candidates: tuple[tuple[float, float], ...]
    chosen: int | None
    velocities: _Array
    spectrum: _Array
    least_coherence: float
    expected: tuple[float, float] | None


@apply_style
def draw_section(picture: SectionPicture) -> Figure:
    """Draw the traces at their places with the line of each candidate, and below the stack over the velocity."""
    lines = [line for part in picture.text.splitlines() for line in textwrap.wrap(part, _CHARACTERS)]
    heights = (3.6, 1.5, 0.1 + 0.17 * len(lines))
    figure = new_figure(height=sum(heights))
    section, spectrum, below = figure.subplots(3, 1, height_ratios=heights)
    ranked = sorted(range(len(picture.candidates)), key=lambda k: -picture.candidates[k][1])[:_MOST_LINES]
    _draw_traces(section, picture)
    _draw_spectrum(spectrum, picture)
    for number, k in enumerate(sorted(ranked), start=1):
        travel, coherence = picture.candidates[k]
        look = {"color": VERMILION if k == picture.chosen else GREY, "zorder": 4.0}
        begin, distance = picture.transmitted_peak, float(picture.places[-1])
        time, place = np.array([begin, begin + travel]) * MS, np.array([0.0, distance]) * MM
        section.plot(time, place, linewidth=1.0, linestyle="-" if k == picture.chosen else "--", **look)
        spectrum.plot(distance / travel, coherence, "o", markersize=4.0, **look)
        for axes, point in ((section, (time[1], 1.1 * place[1])), (spectrum, (distance / travel, coherence))):
            axes.annotate(str(number), point, (0, 3), textcoords="offset points", ha="center", fontsize=8.0, **look)
    letter_panels((section, spectrum))
    below.set_axis_off()
    below.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=7.5, linespacing=1.35, transform=below.transAxes)
    return figure


def _draw_traces(axes: Axes, picture: SectionPicture) -> None:
    """Draw motion across the path at each place, over its largest value, and where the S wave is expected."""
    time, place, begin = picture.times * MS, picture.places * MM, picture.transmitted_peak * MS
    largest = np.abs(picture.clean).max(axis=0, initial=0.0)
    scale = _EXCURSION * place[-1] / len(place) / np.where(largest > 0.0, largest, 1.0)
    for station, offset in enumerate(place.tolist()):
        receiver = station == len(place) - 1
        with_p, clean = (motion[:, station] * scale[station] for motion in (picture.across, picture.clean))
        axes.plot(time, offset + np.clip(with_p, -offset, place[-1]), color=SKY, linewidth=0.8, label="with the P wave")
        label = "P wave removed" if station == 0 else None
        axes.plot(time, offset + clean, color=BLACK if receiver else BLUE, linewidth=1.2, label=label)
        axes.annotate(f"{largest[station]:.2g}", (time[-1], offset), (3, 0), textcoords="offset points", fontsize=7.0)
        if np.isfinite(picture.p_waves[station]):
            peak = picture.p_waves[station] * MS
            axes.plot(peak, offset + np.interp(peak, time, with_p), ".", color=ORANGE, label="P wave")
    if picture.expected is not None:
        late, early = (begin + picture.places[-1] / velocity * MS for velocity in picture.expected)
        axes.fill([begin, late, early], [0.0, place[-1], place[-1]], color=BLUE, alpha=0.08, linewidth=0)
    handles, labels = axes.get_legend_handles_labels()
    shown = dict(zip(labels, handles, strict=True))
    axes.legend(
        shown.values(),
        shown.keys(),
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        borderaxespad=0.0,
        handlelength=1.0,
        columnspacing=1.0,
    )
    axes.set_xlim(0.0, time[-1])
    axes.set_ylim(-0.08 * place[-1], 1.22 * place[-1])
    axes.set_title(picture.title)
    axes.set_xlabel("time (ms); on the right each largest motion over v0")
    axes.set_ylabel("path (mm), receiver last")


def _draw_spectrum(axes: Axes, picture: SectionPicture) -> None:
    """Draw the stack over the velocity."""
    axes.plot(picture.velocities, picture.spectrum, color=BLUE)
    axes.axhline(picture.least_coherence, color=GREY, linewidth=0.8, linestyle=":")
    if picture.expected is not None:
        axes.axvspan(*picture.expected, color=BLUE, alpha=0.12, linewidth=0)
    axes.set_xscale("log")
    axes.set_title("stack along the line of each velocity")
    axes.set_xlim(picture.velocities[0], picture.velocities[-1])
    ticks = [tick for power in (10, 100, 1000, 10_000) for tick in (power, 2 * power, 3 * power, 5 * power)]
    seen = [tick for tick in ticks if picture.velocities[0] <= tick <= picture.velocities[-1]]
    axes.set_xticks(seen, [f"{tick}" for tick in seen])
    axes.minorticks_off()
    axes.set_ylim(min(0.0, float(np.nanmin(picture.spectrum, initial=0.0))), 1.15)
    axes.set_xlabel("velocity (m/s)")
    axes.set_ylabel("coherence")
