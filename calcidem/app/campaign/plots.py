"""The figures of a campaign for Python: ``campaign.plot``."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.figures.film import draw_film, frame_shower, movie_writer, write_movie
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES, load_arrival, read_arrival
from calcidem.analysis.figures.samples import draw_cemented_samples, draw_preferential_paths
from calcidem.analysis.figures.signals import draw_signals
from calcidem.app.campaign.patterns import stored_section
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.film import film_wave
from calcidem.storage.files import write_atomically

_FIGURES = {figure.name: figure for figure in CAMPAIGN_FIGURES}


class CampaignPlots:
    """Figures of one campaign, each a method; those of `calcidem report` take no arguments.

    A figure is a `matplotlib.figure.Figure`: a notebook shows it, and ``figure.savefig("vs.pdf")`` writes it. One for
    which the campaign lacks something raises `calcidem.analysis.campaign_analysis.UnavailableError`.

    Attributes
    ----------
    analysis
        Where the figures have their numbers from; cells that are stored after its first use are not in it.
    """

    def __init__(
        self, analysis: CampaignAnalysis, cemented: Callable[..., tuple[Experiment, npt.NDArray[np.bool_]]]
    ) -> None:
        """Draw figures of a campaign.

        Parameters
        ----------
        analysis
            Of the campaign.
        cemented
            Gives the experiment of a cell, and which contacts are cemented (`Campaign.cemented`).
        """
        self.analysis = analysis
        self._cemented = cemented

    def __dir__(self) -> list[str]:
        """Methods, the figures of a report included."""
        return sorted([*super().__dir__(), *_FIGURES])

    def __getattr__(self, name: str) -> Callable[[], Figure]:
        """Give one of the figures that take no arguments, see `calcidem.analysis.figures.registry`."""
        if name not in _FIGURES:
            raise AttributeError(f"a campaign has no figure '{name}'; it has {', '.join(sorted(_FIGURES))}")
        figure = _FIGURES[name]

        def draw() -> Figure:
            return figure.draw(self.analysis)

        draw.__name__, draw.__doc__ = name, f"{figure.title}.\n\n{figure.caption}"
        return draw

    def signal(self, *, seed: int, content: float) -> Figure:
        """Draw what was sent through one sample and what arrived, with all readings."""
        return draw_signals([load_arrival(self.analysis, seed, content)])

    def cement(self, *, seed: int, content: float) -> Figure:
        """Draw one sample with its cement."""
        sample = self.analysis.sample(seed, content)
        return draw_cemented_samples(self.analysis.graphs[sample.packing_index], [sample])

    def path(self, *, seed: int, content: float) -> Figure:
        """Draw one sample with the path that its wave prefers."""
        sample = self.analysis.sample(seed, content)
        return draw_preferential_paths(self.analysis.graphs[sample.packing_index], [sample])

    def movie(
        self,
        file: str | os.PathLike[str],
        *,
        seed: int,
        content: float,
        frames: int = 90,
        watch: Callable[[int, int], None] = lambda _done, _all: None,
    ) -> Path:
        """Compute one cell's wave again, and write it as moving pictures.

        Colour is the velocity of the disks along y, lines are cemented contacts; below are the signals and readings of
        the cell, with a line for the moment shown.

        Parameters
        ----------
        file
            With the ending .gif, or .mp4 where ffmpeg is installed.
        seed, content
            Which cell; content in percent.
        frames
            How many, at most; 15 are shown in a second.
        watch
            Told how much is done, of how much.

        Raises
        ------
        OutputRefusedError
            For another ending, or without ffmpeg.
        UnknownCellError
            If the cell has no outcome, or its cement is not known.
        """
        path = Path(file)
        writer = movie_writer(path)
        cell = self.analysis.store.cell(seed=seed, content=content)
        experiment, bonded = self._cemented(seed=seed, content=content)
        wave = experiment.wave
        if cell.retry:  # then its wave was sent with half the step
            experiment = replace(experiment, wave=replace(wave, step_fraction=0.5 * wave.step_fraction))
        film = film_wave(
            experiment,
            bonded,
            cell.frequency or experiment.frequency(content),
            frames=frames,
            samples=None if cell.section is None else len(cell.section.across),
            watch=lambda done, count: watch(done, 2 * count),
        )
        shown = replace(cell, section=stored_section(film.record.section))
        figure = draw_film(
            self.analysis.store.packing(cell.packing_index),
            experiment.packing.pairs[bonded],
            (film.x, film.y, film.radius),
            read_arrival(self.analysis, shown),
            (wave.transmitter_half_width, wave.receiver_half_width),
            (film.times, film.velocity),
        )
        count = len(film.times)
        with write_atomically(path) as temporary:
            named = temporary.with_suffix(path.suffix)  # which writers go by
            try:
                show = frame_shower(figure, film.times, film.velocity)
                write_movie(figure, show, count, named, writer, lambda done: watch(count + done, 2 * count))
                named.replace(temporary)
            finally:
                named.unlink(missing_ok=True)
        return path
