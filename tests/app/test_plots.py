"""Figures and movies from Python: `campaign.plot`."""

from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.app.campaign.opened import Campaign, open_campaign
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.dem.wave.domain import domain_of, listening_disks
from calcidem.dem.wave.film import film_wave
from calcidem.storage.errors import OutputRefusedError, UnknownCellError

CELL = {"seed": 1, "content": 5.0}


@pytest.fixture
def campaign(small_database: Path) -> Iterator[Campaign]:
    """Open the small campaign."""
    with open_campaign(small_database) as opened:
        yield opened


def test_plots_are_found_and_explained(campaign: Campaign) -> None:
    """`dir` lists every figure of a report, each has its caption, and other names say what there is."""
    assert {"movie", "signal", *(figure.name for figure in CAMPAIGN_FIGURES)} <= set(dir(campaign.plot))
    assert all(figure.caption in str(getattr(campaign.plot, figure.name).__doc__) for figure in CAMPAIGN_FIGURES)
    assert isinstance(campaign.plot.histograms(), Figure)
    assert isinstance(campaign.plot.signal(**CELL), Figure)
    with pytest.raises(AttributeError, match=r"no figure 'vs_rage'; it has .*vs_range"):
        campaign.plot.vs_rage()


def test_a_film_is_the_stored_wave(campaign: Campaign) -> None:
    """However often one looks, the section keeps its bits, and the disks that listen move as the receiver says."""
    cell = campaign.cell(**CELL)
    experiment, bonded = campaign.cemented(**CELL)
    section = cell.section
    assert section is not None
    count = len(section.across)
    film = film_wave(experiment, bonded, cell.frequency, frames=7, samples=count)
    np.testing.assert_array_equal(film.record.section.across, section.across)
    np.testing.assert_array_equal(film.record.section.along, section.along)
    whole, _ = experiment.stiffen()
    domain = domain_of(whole, experiment.wave, experiment.installation)
    heard = film.velocity[:, listening_disks(domain.packing, experiment.wave)].mean(axis=1)
    last = np.minimum(np.arange(1, 8) * -(-count // 7), count) - 1
    np.testing.assert_allclose(heard, section.received[last], rtol=1e-5, atol=section.resolution)
    np.testing.assert_allclose(film.times, section.time[last] + 0.5 * film.record.time_step)


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
