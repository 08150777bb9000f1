"""`calcidem predict` and `campaign.predict`: velocities of the tutorial's campaign without simulating."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calcidem.analysis.packing_graph import FEATURES
from calcidem.app.campaign import opened
from calcidem.app.campaign.opened import Campaign
from calcidem.app.campaign.prediction import check_predictions
from calcidem.storage.errors import QueryError
from calcidem.storage.records import CementPattern


def cement_shares(campaign: Campaign, seed: int, content: float) -> dict[str, float]:
    """Shares of cemented contacts no further above or below mid-height than the receiver reaches, and of all."""
    sample = campaign.sample(seed=seed, content=content)
    packing, half = sample.packing, campaign.config["wave"]["receiver_half_width"]
    off = np.abs(packing.y[packing.pairs].mean(axis=1) - packing.height / 2.0)
    return {"column_share": (sample.kind[off < half] > 0).mean(), "cemented_share": (sample.kind > 0).mean()}


def test_seed_pattern_and_features_of_a_sample_predict_the_same(campaign: Campaign) -> None:
    """The cement that a seed draws, given as a pattern or by its shares, leads to one prediction."""
    stored = campaign.cell(seed=2, content=5.0)
    features = cement_shares(campaign, seed=2, content=5.0)
    assert campaign.predict(content=5.0, pattern=stored.cement) == campaign.predict(content=5.0, features=features)
    found = campaign.predict(content=5.0, seed=501)
    assert found.interval.low < found.vs < found.interval.high
    # A seed that the campaign has takes no part in its own prediction.
    vs = campaign.vs().sel(content=5.0).dropna("seed")
    alone = campaign.predict(content=5.0, seed=2, features={})
    assert alone.vs == pytest.approx(float(np.exp(np.log(vs.drop_sel(seed=2)).mean())))
    assert campaign.predict(content=5.0).vs == pytest.approx(float(np.exp(np.log(vs).mean())))


def test_a_campaign_without_its_cement_predicts_from_its_content(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no sample's cement can be drawn again, as with an older physics, the column is left out."""
    bare = [replace(cell, cement=None) for cell in campaign.select(content=5.0, status="done")]
    monkeypatch.setattr(opened, "with_patterns", lambda _store, _cells: iter(bare))
    found = campaign.predict(content=5.0, features={"column_share": 0.5})
    assert found == campaign.predict(content=5.0)
    assert not found.uses_features


def test_what_cannot_be_predicted_is_refused(campaign: Campaign) -> None:
    """A content without cells, an unknown feature, and contacts of another packing are told with a cure."""
    with pytest.raises(QueryError, match=r"content = 4 %.*Choose among 0"):
        campaign.predict(content=4.0)
    with pytest.raises(QueryError, match="colour: no such feature"):
        campaign.predict(content=5.0, features={"colour": 1.0})
    with pytest.raises(QueryError, match=r"connectivity = 2 is far from the .* of the samples at 5 %"):
        campaign.predict(content=5.0, features={"path_connectivity": 2.0})
    with pytest.raises(QueryError, match=r"level = 2\.0: is not a probability"):
        campaign.predict(content=5.0, level=2.0)
    strange = CementPattern(np.array([[0, 4000]]), np.array([1]), np.empty((0, 2)))
    with pytest.raises(QueryError, match="do not touch"):
        campaign.predict(content=5.0, pattern=strange)
    stored = campaign.cell(seed=2, content=5.0).features
    with pytest.raises(QueryError, match="give fewer features"):  # eight samples cannot fit eight slopes
        campaign.predict(content=5.0, features={name: float(getattr(stored, name)) for name in FEATURES})


def test_the_command_predicts_and_says_how_far_to_trust_it(
    campaign: Campaign, database: Path, tmp_path: Path, invoke: Callable[..., str]
) -> None:
    """A table over all contents, or one sample by seed, contacts or feature, each with its check."""
    checks, alone = check_predictions(campaign.analyse()), check_predictions(campaign.analyse(), ())
    assert 0.0 not in checks  # one packing, no cement: nothing scatters
    table = invoke("predict", database)
    assert all(f"{check.score:.1f}" in table for check in (*checks.values(), *alone.values()))
    count = sum(check.n for check in checks.values())
    inside = sum(check.coverage * check.n for check in checks.values())
    assert f"In all, {100 * inside / count:.1f} % of {count} samples" in " ".join(table.split())
    cement = campaign.cell(seed=2, content=5.0).cement
    assert cement is not None
    contacts = tmp_path / "contacts.csv"
    contacts.write_text("first,second\n" + "".join(f"{a},{b}\n" for a, b in cement.contacts.tolist()), encoding="utf-8")
    one = " ".join(invoke("predict", database, "--content", 5, "--pattern", contacts).split())
    assert f"5 %: Vs {campaign.predict(content=5.0, pattern=cement).vs:.0f} m/s, 95 %" in one
    assert f"Mean interval score {checks[5.0].score:.0f} m/s" in one
    assert f"{alone[5.0].score:.0f} m/s for the content alone" in one
    invoke("predict", database, "--content", 5, "--feature", "path_bonded_fraction=0.9", "--level", 0.9)
    invoke("predict", database, "--seed", 3, exit_code=2)
    invoke("predict", database, "--level", "nan", exit_code=2)
    invoke("predict", database, "--content", 5, "--feature", "path_bonded_fraction", exit_code=2)
