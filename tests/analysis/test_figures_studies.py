"""The sensitivity studies and their figures, on the small campaign's samples."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from calcidem.analysis.figures import style
from calcidem.analysis.figures.registry import STUDY_FIGURES
from calcidem.analysis.figures.velocities import draw_frequency_study, draw_reading_study
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import stored_packing
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.sensitivity import _damping_study, _frequency_study, _pulse_frequency
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.section import Pulse

pytestmark = pytest.mark.slow

SEEDS = (1, 2, 3, 4, 5)
"""More than four, so that the lanes are those of the campaign and no other kernel has to be compiled."""


@pytest.fixture(scope="module")
def experiment(small_database: Path) -> Experiment:
    """Experiment of the small campaign."""
    with open_campaign(small_database) as campaign:
        return Configuration.from_physics(campaign.config).experiment(stored_packing(campaign.packing()))


@pytest.fixture(scope="module")
def studies(experiment: Experiment) -> dict[str, xr.Dataset]:
    """Both studies with few values."""
    own = experiment.frequency(0.66)
    return {
        "frequency": _frequency_study(experiment, contents=(0.66,), frequencies=(own, 1.5 * own), seeds=SEEDS),
        "damping": _damping_study(experiment, contents=(0.66,), factors=(0.1, experiment.wave.damping), periods=9.0),
    }


def test_width_of_the_sent_pulse_gives_its_frequency() -> None:
    """One period of v0 (1 - cos) has, by its width at half height, exactly its own frequency."""
    interval = 1e-7
    for frequency in (4e3, 25e3):
        pulse = Pulse(1e-3, frequency)
        signal = pulse.velocity(np.arange(0, 2 / frequency, interval))
        found = _pulse_frequency(signal, interval, 0.5 / frequency, reach=0.1 / frequency)
        # The straight line between two samples is off by less than (omega dt)^2 / 8.
        assert found == pytest.approx(frequency, rel=(2 * np.pi * frequency * interval) ** 2)


def test_pulse_that_does_not_end_has_no_frequency() -> None:
    """A signal that stays above half its peak has no width."""
    assert np.isnan(_pulse_frequency(np.linspace(0.6, 1.0, 50), 1e-6, 40e-6, reach=5e-6))


def test_study_at_the_campaigns_frequency_gives_the_campaigns_velocity(
    studies: dict[str, xr.Dataset], small_database: Path
) -> None:
    """With the frequency that the campaign sends, the study measures what the campaign measured."""
    study = studies["frequency"].sel(content=0.66).isel(frequency=0)
    with open_campaign(small_database) as campaign:
        stored = campaign.to_xarray().sel(content=0.66, seed=list(SEEDS))
    assert np.array_equal(study["vs_peak"], stored["vs_peak"])
    assert float(studies["frequency"]["campaign_frequency"].sel(content=0.66)) == study["frequency"]


def test_damping_of_the_campaign_gives_the_campaigns_velocity(
    studies: dict[str, xr.Dataset], small_database: Path, experiment: Experiment
) -> None:
    """With the campaign's damping factor, a longer record gives the same peak."""
    study = studies["damping"].sel(content=0.66, damping=experiment.wave.damping)
    with open_campaign(small_database) as campaign:
        stored = float(campaign.vs().sel(content=0.66, seed=1))
    assert float(study["vs_peak"]) == pytest.approx(stored, rel=1e-6)  # recorded alone, its step is a little longer


def test_damping_takes_amplitude(studies: dict[str, xr.Dataset], experiment: Experiment) -> None:
    """The more a sample is damped, the smaller is what it passes on."""
    received = abs(studies["damping"]["received"].sel(content=0.66)).max("sample")
    assert float(received.sel(damping=0.1)) > float(received.sel(damping=experiment.wave.damping))


def test_every_number_of_a_study_has_a_unit(studies: dict[str, xr.Dataset]) -> None:
    """All variables and coordinates of the studies carry units."""
    for study in studies.values():
        assert all(study[name].attrs.get("units") for name in study.variables)


@pytest.mark.parametrize("entry", STUDY_FIGURES, ids=lambda entry: entry.name)
def test_every_study_figure_is_drawn(entry: object, studies: dict[str, xr.Dataset]) -> None:
    """Each study has its figures."""
    assert style.render(entry.draw(studies[entry.study]), "png").startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_means_of_a_study_are_of_the_same_samples_at_the_true_frequencies() -> None:
    """A sample that loses its velocity does not move the mean, and no curve stands beside its frequencies."""
    frequency, contents, constant = np.array([5e3, 10e3, 15e3]), [0.66, 5.0], np.array([[300.0], [400.0]])
    vs = np.tile(constant, (2, 1, 3))
    vs[:, 1, 2] = np.nan
    shape, campaign = ("content", "seed", "frequency"), ("content", np.full(2, 10e3))
    study = xr.Dataset(
        {"vs_peak": (shape, vs), "vs_first_arrival": (shape, np.full_like(vs, np.nan))}
        | {"received_frequency": (shape, np.tile(frequency, (2, 2, 1))), "campaign_frequency": campaign},
        coords={"content": contents, "seed": [1, 2], "frequency": frequency},
        attrs={"distance": 0.1},
    )
    bold = draw_reading_study(study).axes[0].get_lines()[2]
    assert np.array_equal(bold.get_xydata(), [(5.0, 350.0), (10.0, 350.0)])
    curves = draw_frequency_study(study).axes[1].get_lines()
    assert all(np.array_equal(curve.get_xdata(), [5.0, 10.0]) for curve in curves[::2])
    assert all(set(dashed.get_xdata()) == {10.0} for dashed in curves[1::2])
