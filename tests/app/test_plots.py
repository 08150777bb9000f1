"""Figures and movies from Python: `campaign.plot`."""

import inspect
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.app.campaign import plots
from calcidem.app.campaign.opened import Campaign, open_campaign
from calcidem.app.campaign.plots import CampaignPlots, _with_settings_of
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.dem.wave.experiment import domain_of, listening_disks
from calcidem.dem.wave.propagation import film_wave
from calcidem.storage.errors import OutputRefusedError, UnknownCellError

CELL = {"seed": 1, "content": 5.0}


@pytest.fixture
def campaign(small_database: Path) -> Iterator[Campaign]:
    """Open the small campaign."""
    with open_campaign(small_database) as opened:
        yield opened


def test_plots_are_found_and_explained(campaign: Campaign) -> None:
    """Every figure of a report is a method whose documentation has its caption and says what `ax` is."""
    for figure in CAMPAIGN_FIGURES:
        method = getattr(CampaignPlots, figure.name)
        assert figure.caption in str(method.__doc__)
        assert inspect.signature(method).parameters["ax"].annotation == Axes | None
    assert isinstance(campaign.plot.histograms(), Figure)


def test_laboratory_velocities_are_drawn_beside_a_campaign(campaign: Campaign, tmp_path: Path) -> None:
    """From a table as a laboratory writes it, without a change of the campaign's other figures."""
    table = tmp_path / "measured.csv"
    table.write_text("content (%);Vs (m/s)\n1,5;512,5\n", encoding="utf-8")
    (axes,) = campaign.plot.vs_range(measured=table).axes
    assert "measured specimen" in axes.figure.legends[0].get_texts()[-1].get_text()
    assert campaign.plot.analysis.measured == ()


def test_a_figure_of_one_panel_is_drawn_into_own_axes(campaign: Campaign) -> None:
    """What the axes hold stays, the velocities come beside it, and the figure returned is that of the axes."""
    figure, (axes, other) = plt.subplots(1, 2)
    own = axes.errorbar([2.4], [700.0], yerr=[60.0], label="own data")
    assert campaign.plot.vs_range(ax=axes) is figure
    assert figure.axes == [axes, other]
    labels = axes.get_legend_handles_labels()[1]
    assert own in axes.containers
    assert {"own data", "mean", "95 % interval of the mean"} <= set(labels)
    assert not other.has_data()
    plt.close(figure)


def test_a_figure_of_several_panels_takes_the_place_of_own_axes(campaign: Campaign) -> None:
    """It is in the caller's figure, within the grid cell of the axes; axes without a grid are refused as they were."""
    figure, (axes, other) = plt.subplots(1, 2, layout="constrained")
    assert campaign.plot.signal(**CELL, ax=axes) is figure
    assert campaign.plot.methods(ax=other) is figure
    figure.draw_without_rendering()
    assert len(figure.axes) >= 3
    assert {axes, other}.isdisjoint(figure.axes)
    assert sum(panel.get_window_extent().x0 > 0.5 * figure.bbox.width for panel in figure.axes) == 2
    free = figure.add_axes((0.0, 0.0, 0.1, 0.1))
    plain, beside = plt.subplots(1, 2, figsize=(10, 4))
    campaign.plot.signal(**CELL, ax=beside[1])
    plain.draw_without_rendering()
    part = plain.subfigs[0]
    texts = [text.get_window_extent() for axes in part.axes for text in axes.texts]
    assert texts
    assert (
        max(extent.x1 for extent in texts) <= plain.bbox.x1
    )  # which needs a layout, whether the caller gave one or not
    with pytest.raises(ValueError, match=r"make it with plt\.subplots"):
        campaign.plot.methods(ax=free)
    assert free in figure.axes
    plt.close(figure)


def test_a_film_is_the_stored_wave(campaign: Campaign) -> None:
    """However often one looks, the section keeps its bits, and the disks that listen move as the receiver says."""
    cell = campaign.cell(**CELL)
    experiment, bonded = campaign.cemented(**CELL)
    section = cell.section
    assert section is not None
    count = len(section.across)
    experiment = experiment.with_wave(law=cell.law)
    film = film_wave(experiment, bonded, cell.frequency, frames=7, steps=cell.steps)
    np.testing.assert_array_equal(film.section.across, section.across)
    np.testing.assert_array_equal(film.section.along, section.along)
    whole, _ = experiment.stiffen()
    domain = domain_of(whole, experiment.wave, experiment.installation)
    heard = film.velocity[:, listening_disks(domain.packing, experiment.wave)].mean(axis=1)
    last = np.minimum(np.arange(1, 8) * -(-count // 7), count) - 1
    np.testing.assert_allclose(heard, section.received[last], rtol=1e-5, atol=section.resolution)
    np.testing.assert_allclose(film.times, section.time[last] + 0.5 * film.section.time_step)


def test_a_movie_has_the_step_of_its_cell(campaign: Campaign) -> None:
    """As configured, or halved as often as the stored step says."""
    cell, (experiment, _) = campaign.store.cell(**CELL), campaign.cemented(**CELL)
    assert cell.time_step is not None
    steps = [cell.time_step, 0.5 * cell.time_step, 0.25 * cell.time_step]
    found = [_with_settings_of(experiment, replace(cell, time_step=step)).wave.step_fraction for step in steps]
    assert found == [part * experiment.wave.step_fraction for part in (1.0, 0.5, 0.25)]


def test_a_movie_ends_with_the_record_of_its_cell(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if the campaign stores no sections."""
    films, film, cell = [], plots.film_wave, campaign.store.cell(**CELL)
    assert cell.section is not None
    monkeypatch.setattr(campaign.store, "cell", lambda **_: replace(cell, section=None))
    monkeypatch.setattr(plots, "film_wave", lambda *given, **named: films.append(film(*given, **named)) or films[-1])
    campaign.plot.movie(tmp_path / "wave.gif", **CELL, frames=2)
    assert [len(one.section.across) for one in films] == [len(cell.section.across)]


def test_a_movie_has_the_frames_asked_for(campaign: Campaign, tmp_path: Path) -> None:
    """A GIF has so many different frames, and whoever waits is told of them all."""
    told = []
    file = campaign.plot.movie(tmp_path / "wave.gif", **CELL, frames=3, watch=lambda *done: told.append(done))
    with Image.open(file) as movie:
        assert movie.n_frames == 3
        frames = []
        for number in range(3):
            movie.seek(number)
            frames.append(movie.convert("RGB").tobytes())
    assert len(set(frames)) == 3
    assert told == [(done, 6) for done in range(1, 7)]
    assert [path.name for path in tmp_path.iterdir()] == ["wave.gif"]


def test_a_movie_that_cannot_be_made_says_so_at_once(campaign: Campaign, tmp_path: Path) -> None:
    """Another ending, no ffmpeg, and a cell that was never computed are bad input; nothing is written."""
    with mpl.rc_context({"animation.ffmpeg_path": "/nowhere"}):
        for name, words in (("wave.mp4", "apt-get install ffmpeg.*gif"), ("wave.avi", "neither .gif nor .mp4")):
            with pytest.raises(OutputRefusedError, match=words) as caught:
                campaign.plot.movie(tmp_path / name, **CELL)
            assert _exit_code_of(caught.value) == 2
    with pytest.raises(UnknownCellError):
        campaign.plot.movie(tmp_path / "wave.gif", seed=6, content=0.34)
    assert not list(tmp_path.iterdir())
