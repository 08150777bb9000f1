"""Picture of a space-time section: what the stations recorded, and the lines along which it was stacked."""

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calcidem.analysis.figures import style
from calcidem.analysis.figures.style import MM, MS
from calcidem.app.campaign.diagnosis import Diagnosis
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.reading import LEAST_COHERENCE, find_candidates, prepare, velocity_spectrum
from calcidem.dem.wave.section import Section

_MOST_LINES = 6  # candidates that are shown, the most coherent ones
_EXCURSION = 0.75  # largest value of a trace over the mean distance of the stations
_CHARACTERS = 100  # in a line of text
_TICKS = tuple(digit * 10**power for power in (1, 2, 3, 4) for digit in (1, 2, 3, 5))  # m/s


@style.apply_style
def draw_diagnosis(one: Diagnosis) -> Figure:
    """Draw the traces at their places with the line of each candidate, and below the stack over the velocity."""
    section, smoothing, expected = one.section, one.experiment.pick.smoothing, one.expected
    arrival = None if one.reading.arrival is None else one.reading.arrival.index
    said = f"No velocity: {one.reason}.", one.finding, *one.describe_remedies()
    lines = [line for text in said for line in textwrap.wrap(text, _CHARACTERS)]
    heights = (3.6, 1.5, 0.1 + 0.17 * len(lines))
    figure = style.new_figure(height=sum(heights))
    traces, spectrum, below = figure.subplots(3, 1, height_ratios=heights)
    candidates = find_candidates(section, smoothing)
    shown = sorted(candidates, key=lambda peak: (peak.index != arrival, -peak.coherence))[:_MOST_LINES]
    _draw_traces(traces, section, smoothing, shown[0].clean if shown else None)
    found = [section.distance / peak.travel_time for peak in candidates] + ([one.vs] if one.vs is not None else [])
    _draw_spectrum(spectrum, section, smoothing, found)
    if expected[0] > 0.0:
        late, early = (MS * (0.5 / section.frequency + section.distance / velocity) for velocity in expected)
        begin, end = 0.5 * MS / section.frequency, MM * section.distance
        traces.fill([begin, late, early], [0.0, end, end], color=style.BLUE, alpha=0.08, linewidth=0)
        spectrum.axvspan(*expected, color=style.BLUE, alpha=0.12, linewidth=0)
    for number, peak in enumerate(sorted(shown, key=lambda peak: peak.index), start=1):
        color, place = style.VERMILION if peak.index == arrival else style.GREY, (peak.travel_time, peak.coherence)
        _draw_line((traces, spectrum), section, place, str(number), color)
    if one.vs is not None:
        place = section.distance / one.vs, float(velocity_spectrum(section, smoothing, np.array([one.vs]))[0])
        _draw_line((traces, spectrum), section, place, "remedy", style.GREEN)
    traces.set_title(f"{one.key.content:g} %, seed {one.key.seed}")
    style.letter_panels((traces, spectrum))
    below.set_axis_off()
    below.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=7.5, linespacing=1.35, transform=below.transAxes)
    return figure


def _draw_traces(axes: Axes, section: Section, smoothing: float, clean: Floats | None) -> None:
    """Draw the motion across the path at each place over its largest value, with the P wave and without it."""
    across, place = prepare(section, smoothing).across, np.array(section.places) * MM
    time, clean = section.times[: len(across)] * MS, across if clean is None else clean
    largest = np.abs(clean).max(axis=0, initial=0.0)
    scale = _EXCURSION * place[-1] / len(place) / np.where(largest > 0.0, largest, 1.0)
    axes.plot(time, place + np.clip(across * scale, -place, place[-1]), color=style.SKY, linewidth=0.8)
    axes.plot(time, place + clean * scale, color=style.BLUE, linewidth=1.2)
    for offset, value in zip(place, largest, strict=True):
        axes.annotate(f"{value:.2g}", (time[-1], offset), (3, 0), textcoords="offset points", fontsize=7.0)
    axes.set(xlim=(0.0, time[-1]), ylim=(-0.08 * place[-1], 1.22 * place[-1]), ylabel="path (mm), receiver last")
    axes.set_xlabel("time (ms); light: with the P wave; on the right each largest motion over v0")


def _draw_spectrum(axes: Axes, section: Section, smoothing: float, found: list[float]) -> None:
    """Draw the stack over the velocity, from the slowest wave in the record to twice the fastest that was found."""
    slowest = section.distance / max(section.duration, 1.0 / section.frequency)
    velocities = np.geomspace(slowest, 2.0 * max(found, default=50.0 * slowest), 240)
    axes.plot(velocities, velocity_spectrum(section, smoothing, velocities), color=style.BLUE)
    axes.axhline(LEAST_COHERENCE, color=style.GREY, linewidth=0.8, linestyle=":")
    axes.set(xscale="log", xlim=(velocities[0], velocities[-1]), ylim=(-0.25, 1.15))
    axes.set_xticks(seen := [tick for tick in _TICKS if velocities[0] <= tick <= velocities[-1]], map(str, seen))
    axes.minorticks_off()
    axes.set(title="stack along the line of each velocity", xlabel="velocity (m/s)", ylabel="coherence")


def _draw_line(panels: tuple[Axes, Axes], section: Section, peak: tuple[float, float], name: str, color: str) -> None:
    """Draw the line of a travel time, s, through the traces, and its coherence in the spectrum."""
    begin, end, shift = 0.5 / section.frequency, MM * section.distance, -11 if name == "remedy" else 3
    arrived, velocity, dashes = MS * (begin + peak[0]), section.distance / peak[0], "--" if color == style.GREY else "-"
    panels[0].plot([MS * begin, arrived], [0.0, end], color=color, linewidth=1.0, linestyle=dashes)
    panels[1].plot(velocity, peak[1], "o", markersize=4.0, color=color, zorder=4.0)
    for axes, point in zip(panels, ((arrived, 1.1 * end), (velocity, peak[1])), strict=True):
        axes.annotate(name, point, (0, shift), textcoords="offset points", ha="center", fontsize=8.0, color=color)
