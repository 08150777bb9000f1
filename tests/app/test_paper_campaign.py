"""The campaign that comes with the package."""

import doctest

import numpy as np
import pytest
from places import CHECKOUT

import calcidem
from calcidem.analysis.measured import published_study
from calcidem.app.campaign import opened


def test_its_docstring_is_true() -> None:
    """The example in the docstring gives what it says."""
    (example,) = doctest.DocTestFinder().find(opened.load_paper_campaign, globs={})
    result = doctest.DocTestRunner().run(example)
    assert result.attempted > 0
    assert result.failed == 0


def test_it_is_the_campaign_of_the_pages() -> None:
    """The page on the reproduction names its hash, which is that of the preset."""
    identity = calcidem.load_paper_campaign().attrs["calcidem_campaign_hash"]
    assert f"hash {identity[:12]}" in (CHECKOUT / "docs" / "reproduction.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("content", "printed"), [(content, row.mean) for content, row in published_study().velocities])
def test_every_mean_is_near_the_published_one(content: float, printed: float) -> None:
    """All 16 means of Table 3 are met within 5 %."""
    vs = calcidem.load_paper_campaign().vs.sel(content=content)
    assert float(vs.mean()) == pytest.approx(printed, rel=0.05)


def test_few_samples_cannot_be_read() -> None:
    """At least 99.5 % of all and 98 % at each content are read: those that cannot be read are no random part."""
    read = calcidem.load_paper_campaign().vs.notnull()
    assert float(read.mean()) >= 0.995
    assert float(read.mean("seed").min()) >= 0.98


def test_scatter_grows_with_content_and_falls_again() -> None:
    """As in Table 3, the standard deviation is largest between 4 and 7 %, and there is none without cement."""
    scatter = calcidem.load_paper_campaign().vs.std("seed")
    assert 4.0 <= float(scatter.idxmax()) <= 7.0
    assert float(scatter.sel(content=0.0)) == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.isfinite(scatter))


def test_scatter_is_of_the_published_size() -> None:
    """The sd over the mean is 0.75 to 1.33 of Table 3's at thirteen contents, and 0.6 to 1.6 at all."""
    vs = calcidem.load_paper_campaign().vs
    parts = []
    for content, row in published_study().velocities:
        here = vs.sel(content=content)
        parts.append(float(here.std("seed", ddof=1) / here.mean()) / (row.standard_deviation / row.mean))
    assert min(parts) >= 0.6
    assert max(parts) <= 1.6
    assert sum(0.75 <= part <= 1.33 for part in parts) >= 13
