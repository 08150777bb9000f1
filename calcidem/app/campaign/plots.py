"""Figures of a campaign in Python, ``campaign.plot``."""

import math
import os
import textwrap
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError
from calcidem.analysis.figures import style
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.analysis.figures.samples import (
    draw_cemented_samples,
    draw_film,
    draw_preferential_paths,
    draw_signals,
    load_arrival,
    movie_writer,
    read_arrival,
    write_movie,
)
from calcidem.analysis.figures.style import MM, MS, drawn_in
from calcidem.app.campaign.packing import section_of, section_reader, stored_section
from calcidem.app.config.reader import read_targets
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.propagation import film_wave
from calcidem.dem.wave.reading import Reading
from calcidem.dem.wave.section import RESOLUTION, Section, fitness
from calcidem.ends import Verdict
from calcidem.storage.files import write_atomically
from calcidem.storage.records import CellResult

_FIGURES = {figure.name: figure for figure in CAMPAIGN_FIGURES}

_Method = TypeVar("_Method", bound=Callable[..., Figure])


def _with_caption(method: _Method) -> _Method:
    """Add the caption to the documentation of a method that draws a figure of the report."""
    arguments = """Parameters
----------
ax
    Axes of the caller in which, or in whose place, it is drawn; None for a figure of its own.

Returns
-------
matplotlib.figure.Figure
    The whole figure."""
    method.__doc__ = f"{method.__doc__}\n\n{_FIGURES[method.__name__].caption}\n\n{arguments}"
    return method


def _with_settings_of(experiment: Experiment, cell: CellResult) -> Experiment:
    """Return the experiment with contact law and step of a cell, as its check or a guard chose them."""
    if cell.law is not None:
        experiment = experiment.with_wave(law=cell.law)
    if cell.time_step is None or cell.stability_limit is None:
        return experiment
    halvings = round(math.log2(experiment.wave.step_fraction * cell.stability_limit / cell.time_step))
    return experiment.with_wave(step_fraction=experiment.wave.step_fraction * 0.5**halvings)


class CampaignPlots:
    """Figures of one campaign, each a method.

    Each returns its `matplotlib.figure.Figure`: a notebook shows it, and ``figure.savefig("vs.pdf")`` writes it. Each
    accepts `ax`, axes of the caller's own figure, which is then returned. `vs_range`, `weight_scan` and `conductance`
    are drawn into these axes, where own data can be added. Figures of several panels replace the axes, which have to
    be made by `plt.subplots`.

    A figure without its data raises `calcidem.analysis.campaign_analysis.UnavailableError`.

    Attributes
    ----------
    analysis
        Source of the numbers; it does not contain cells stored after its first use.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> figure, axes = plt.subplots()
    >>> plots = open_campaign("quick.db").plot
    >>> plots.vs_range(ax=axes) is figure
    True
    >>> _ = axes.errorbar([2.4], [700.0], yerr=[60.0], fmt="s", label="own data")
    """

    def __init__(
        self, analysis: CampaignAnalysis, cemented: Callable[..., tuple[Experiment, npt.NDArray[np.bool_]]]
    ) -> None:
        """Draw figures of a campaign; ``cemented`` is `Campaign.cemented`."""
        self.analysis = analysis
        self._cemented = cemented

    @_with_caption
    def vs_range(self, ax: Axes | None = None, *, measured: str | os.PathLike[str] | None = None) -> Figure:
        """Draw Vs of all samples against calcite content, with means and intervals.

        ``measured`` is a table of laboratory velocities, as for `calcidem report --measured`, drawn beside.
        """
        targets = () if measured is None else read_targets(Path(measured))
        return self._draw("vs_range", ax, replace(self.analysis, measured=targets) if targets else None)

    @_with_caption
    def histograms(self, ax: Axes | None = None) -> Figure:
        """Draw the distribution of Vs at each content."""
        return self._draw("histograms", ax)

    @_with_caption
    def samples(self, ax: Axes | None = None) -> Figure:
        """Draw cemented samples of one seed."""
        return self._draw("samples", ax)

    @_with_caption
    def measurement(self, ax: Axes | None = None) -> Figure:
        """Draw transmitter and receiver."""
        return self._draw("measurement", ax)

    @_with_caption
    def signals(self, ax: Axes | None = None) -> Figure:
        """Draw transmitted and received signals of some contents, with their arrivals."""
        return self._draw("signals", ax)

    @_with_caption
    def methods(self, ax: Axes | None = None) -> Figure:
        """Draw Vs by three methods of reading."""
        return self._draw("methods", ax)

    @_with_caption
    def dispersion(self, ax: Axes | None = None) -> Figure:
        """Draw phase velocity against frequency."""
        return self._draw("dispersion", ax)

    @_with_caption
    def paths(self, ax: Axes | None = None) -> Figure:
        """Draw the preferential paths of a slow, a middle and a fast sample."""
        return self._draw("paths", ax)

    @_with_caption
    def correlations(self, ax: Axes | None = None) -> Figure:
        """Draw the correlation of path features and Vs."""
        return self._draw("correlations", ax)

    @_with_caption
    def weight_scan(self, ax: Axes | None = None) -> Figure:
        """Draw the correlation of C_d,n with Vs over the ratio of the contact weights."""
        return self._draw("weight_scan", ax)

    @_with_caption
    def laws(self, ax: Axes | None = None) -> Figure:
        """Draw Vs against connectivity, with the fitted laws."""
        return self._draw("laws", ax)

    @_with_caption
    def network_correlations(self, ax: Axes | None = None) -> Figure:
        """Draw the correlation of features of the cement as a network and Vs."""
        return self._draw("network_correlations", ax)

    @_with_caption
    def conductance(self, ax: Axes | None = None) -> Figure:
        """Draw Vs against the conductance of the cement, with the fitted law."""
        return self._draw("conductance", ax)

    @_with_caption
    def narrowing(self, ax: Axes | None = None) -> Figure:
        """Draw the width of intervals against the number of seeds."""
        return self._draw("narrowing", ax)

    def signal(self, *, seed: int, content: float, ax: Axes | None = None) -> Figure:
        """Draw the transmitted and the received signal of one sample, with all readings."""
        with drawn_in(ax):
            return draw_signals([load_arrival(self.analysis, seed, content)])

    def section(self, *, seed: int, content: float, ax: Axes | None = None) -> Figure:
        """Draw the section of one sample with the fitted wave, and the coherence of waves against velocity.

        Traces are divided by their largest value. The dashed line leads to the peak of the fitted wave, the solid one
        to the peak that is read.
        """
        cell = self.analysis.cell(seed, content)
        if cell.section is None:
            raise UnavailableError(f"no section is stored for seed {seed} at {content:g} %")
        said = f"{cell.key}: {cell.reason if cell.vs is None else f'Vs = {cell.vs:.0f} m/s'}"
        with drawn_in(ax):
            return _draw_section(section_of(cell.section), section_reader(self.analysis.store)(cell), said)

    def cement(self, *, seed: int, content: float, ax: Axes | None = None) -> Figure:
        """Draw one sample with its cement."""
        sample = self.analysis.sample(seed, content)
        with drawn_in(ax):
            return draw_cemented_samples(self.analysis.graphs[sample.packing_index], [sample])

    def path(self, *, seed: int, content: float, ax: Axes | None = None) -> Figure:
        """Draw one sample with its preferential path."""
        sample = self.analysis.sample(seed, content)
        with drawn_in(ax):
            return draw_preferential_paths(self.analysis.graphs[sample.packing_index], [sample])

    def _draw(self, name: str, ax: Axes | None, analysis: CampaignAnalysis | None = None) -> Figure:
        """Draw a figure of the report, in axes of the caller if given, of another analysis than the own if given."""
        with drawn_in(ax):
            return _FIGURES[name].draw(analysis or self.analysis)

    def movie(
        self,
        file: str | os.PathLike[str],
        *,
        seed: int,
        content: float,
        frames: int = 90,
        watch: Callable[[int, int], None] = lambda _done, _all: None,
    ) -> Path:
        """Compute the wave of one cell again, and write a movie: .gif, or .mp4 if ffmpeg is installed.

        Colour is the velocity of the disks along y, lines are cemented contacts. Below are the signals and arrivals of
        the cell, with a line at the time shown. ``frames`` is the largest number of frames, shown at 15 a second.
        ``watch`` receives the numbers of finished and of all frames. `OutputRefusedError` for another ending, or
        without ffmpeg; `UnknownCellError` if the cell has no outcome, or its cement is unknown.
        """
        path = Path(file)
        writer = movie_writer(path)
        cell = self.analysis.store.cell(seed=seed, content=content)
        experiment, bonded = self._cemented(seed=seed, content=content)
        wave = experiment.wave
        film = film_wave(
            _with_settings_of(experiment, cell),
            bonded,
            cell.frequency or experiment.frequency(content),
            frames=frames,
            steps=cell.steps,
            watch=lambda done, count: watch(done, 2 * count),
        )
        shown = replace(cell, section=stored_section(film.section))
        moving = film.times, film.velocity
        figure = draw_film(
            self.analysis.store.packing(cell.packing_index),
            experiment.packing.pairs[bonded],
            (film.x, film.y, film.radius),
            read_arrival(self.analysis, shown),
            (wave.transmitter_half_width, wave.receiver_half_width),
            moving,
        )
        count = len(film.times)
        with write_atomically(path) as temporary:
            named = temporary.with_suffix(path.suffix)  # writers use its ending
            try:
                write_movie(figure, moving, named, writer, lambda done: watch(count + done, 2 * count))
                named.replace(temporary)
            finally:
                named.unlink(missing_ok=True)
        return path


@style.apply_style
def _draw_section(section: Section, found: Reading | Verdict, title: str) -> Figure:
    """Draw the traces at their places with the lines of both peaks, and below the coherence against velocity."""
    figure = style.new_figure(height=5.1)
    traces, spectrum = figure.subplots(2, 1, height_ratios=(3.6, 1.5))
    _draw_traces(traces, section)
    if isinstance(found, Reading):
        begin, end = 0.5 * MS / section.frequency, MM * section.distance
        fitted = section.distance / (found.wave.velocity * (1.0 + found.bias))
        wave, peak = (fitted, style.GREY, "--", "fitted wave"), (found.travel_time, style.VERMILION, "-", "peak read")
        for travel, color, dashes, label in (wave, peak):
            if np.isfinite(travel):
                ends = [begin, begin + MS * travel], [0.0, end]
                traces.plot(*ends, dashes, color=color, linewidth=1.0, label=label)
        figure.legend(loc="outside upper center", ncols=2)
        _draw_spectrum(spectrum, section, found)
    traces.set_title(textwrap.fill(title, 72))
    style.letter_panels((traces, spectrum))
    return figure


def _draw_traces(axes: Axes, section: Section) -> None:
    """Draw the motion across the path at each place over its largest value."""
    across, place = section.across * RESOLUTION, np.array(section.places) * MM
    time, largest = section.times * MS, np.abs(across).max(axis=0, initial=0.0)
    # The largest value of a trace is three quarters of the mean distance of the stations.
    scale = 0.75 * place[-1] / len(place) / np.where(largest > 0.0, largest, 1.0)
    axes.plot(time, place + across * scale, color=style.BLUE, linewidth=1.0)
    for offset, value in zip(place, largest, strict=True):
        axes.annotate(f"{value:.2g}", (time[-1], offset), (3, 0), textcoords="offset points", fontsize=7.0)
    axes.set(xlim=(0.0, time[-1]), ylim=(-0.08 * place[-1], 1.22 * place[-1]), ylabel="path (mm), receiver last")
    axes.set_xlabel("time (ms); on the right each largest motion over v0")


def _draw_spectrum(axes: Axes, section: Section, found: Reading) -> None:
    """Draw the coherence of section and waves against velocity, from half of the fitted wave's to twice as much."""
    velocities = np.geomspace(0.5 * found.wave.velocity, 2.0 * found.wave.velocity, 240)
    axes.plot(velocities, fitness(section, found.wave.clamp, velocities), color=style.BLUE)
    axes.plot(found.wave.velocity, found.wave.coherence, "o", markersize=4.0, color=style.GREY)
    axes.set(xscale="log", xlim=(velocities[0], velocities[-1]), ylim=(0.0, 1.05))
    ticks = [digit * 10**power for power in (1, 2, 3, 4) for digit in (1, 2, 3, 5)]  # m/s
    axes.set_xticks(seen := [tick for tick in ticks if velocities[0] <= tick <= velocities[-1]], map(str, seen))
    axes.minorticks_off()
    axes.set(title="fit of a damped wave", xlabel="velocity (m/s)", ylabel="coherence")
