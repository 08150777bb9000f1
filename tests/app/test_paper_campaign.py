"""The campaign that comes with the package."""

import doctest
import json
import tomllib

import numpy as np
import pytest

import calcidem
from calcidem.analysis.published import published_study
from calcidem.app.campaign import opened
from calcidem.app.config.presets import preset_text
from calcidem.app.config.reader import read_configuration


def test_its_docstring_is_true() -> None:
    """The example in the docstring gives what it says."""
    (example,) = doctest.DocTestFinder().find(opened.load_paper_campaign, globs={})
    result = doctest.DocTestRunner().run(example)
    assert result.attempted > 0
    assert result.failed == 0


def test_it_was_computed_with_the_sample_of_the_preset() -> None:
    """Packing, materials and cement are those of the preset; physics version 3 read it in the former way."""
    physics = read_configuration(tomllib.loads(preset_text("paper"))).physics
    shipped = json.loads(calcidem.load_paper_campaign().attrs["calcidem_config"])
    assert shipped["physics_version"] == 3
    for section in ("root_seed", "packing", "sand", "cement", "pattern"):
        assert shipped[section] == physics[section], section
    sent = {
        "amplitude",
        "transmitter",
        "transmitter_half_width",
        "receiver_half_width",
        "damping",
        "regime",
        "frequency",
    }
    assert {key: shipped["wave"][key] for key in sent} == {key: physics["wave"][key] for key in sent}


@pytest.mark.parametrize(("content", "printed"), [(content, row.mean) for content, row in published_study().velocities])
def test_every_mean_is_near_the_published_one(content: float, printed: float) -> None:
    """All 16 means of Table 3 are met within 6 %."""
    vs = calcidem.load_paper_campaign().vs.sel(content=content)
    assert float(vs.mean()) == pytest.approx(printed, rel=0.06)


def test_few_samples_cannot_be_read() -> None:
    """At least 97 % at each content from 0.55 % up, and 90 % below: those that cannot be read are no random part."""
    read = calcidem.load_paper_campaign().vs.notnull().mean("seed")
    assert float(read.sel(content=slice(0.5, None)).min()) >= 0.97
    assert float(read.min()) >= 0.9


def test_scatter_grows_with_content_and_falls_again() -> None:
    """As in Table 3, the standard deviation is largest between 4 and 7 %, and there is none without cement."""
    scatter = calcidem.load_paper_campaign().vs.std("seed")
    assert 4.0 <= float(scatter.idxmax()) <= 7.0
    assert float(scatter.sel(content=0.0)) == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.isfinite(scatter))


def test_scatter_is_of_the_published_size() -> None:
    """The sd over the mean is 0.75 to 1.33 of Table 3's at twelve contents or more, and 0.6 to 1.6 at all."""
    vs = calcidem.load_paper_campaign().vs
    parts = []
    for content, row in published_study().velocities:
        here = vs.sel(content=content)
        parts.append(float(here.std("seed", ddof=1) / here.mean()) / (row.standard_deviation / row.mean))
    assert min(parts) >= 0.6
    assert max(parts) <= 1.6
    assert sum(0.75 <= part <= 1.33 for part in parts) >= 12
