"""`calcidem predict` and `campaign.predict`: velocities of the tutorial's campaign without simulating."""

import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calcidem.analysis.intervals import Interval
from calcidem.app.campaign.opened import Campaign, check_predictions, predict_velocity
from calcidem.storage.errors import QueryError
from calcidem.storage.records import CementPattern


def test_seed_and_pattern_of_a_sample_predict_the_same(campaign: Campaign) -> None:
    """The cement that a seed draws leads to the prediction of its pattern; the seed takes no part in its own."""
    stored = campaign.cell(seed=2, content=5.0)
    found = campaign.predict(content=5.0, pattern=stored.cement)
    assert found.uses_features
    assert campaign.predict(content=5.0, seed=2).vs == pytest.approx(found.vs, rel=0.3)  # of seven other samples
    new = campaign.predict(content=5.0, seed=501)
    assert new.interval.low < new.vs < new.interval.high
    vs = campaign.vs().sel(content=5.0).dropna("seed")
    assert campaign.predict(content=5.0).vs == pytest.approx(float(np.exp(np.log(vs).mean())))
    alone = predict_velocity(campaign.analyse(), 5.0, without_seed=2)
    assert alone.vs == pytest.approx(float(np.exp(np.log(vs.drop_sel(seed=2)).mean())))


def test_the_sample_without_cement_has_the_interval_of_its_error(campaign: Campaign) -> None:
    """All seeds are that sample, so nothing else scatters."""
    cell = campaign.cell(seed=1, content=0.0)
    assert cell.vs is not None
    assert cell.vs_error is not None
    found = campaign.predict(content=0.0, seed=501)
    assert (found.vs, found.uses_features) == (cell.vs, False)
    assert found.interval == Interval.of_velocity(cell.vs, cell.vs_error)
    assert found.interval.low < found.vs < found.interval.high


def test_the_feature_is_the_stored_conductance(campaign: Campaign) -> None:
    """From the pattern of the cement comes what the cell's record has."""
    cell, graph = campaign.cell(seed=2, content=5.0), campaign.analyse().graphs[0]
    assert cell.network is not None
    assert cell.cement is not None
    again = graph.network_features(graph.kinds(cell.cement) > 0).network_conductance
    assert again == pytest.approx(cell.network.network_conductance, rel=1e-9)  # SuperLU's last bits are the processor's


def test_a_campaign_without_conductances_predicts_from_its_content(campaign: Campaign) -> None:
    """Where no sample has one, the feature is left out."""
    cement, analysis = campaign.cell(seed=2, content=5.0).cement, campaign.analyse()
    analysis.cells["network_conductance"][:] = np.nan
    found = predict_velocity(analysis, 5.0, cement)
    assert found == campaign.predict(content=5.0)
    assert not found.uses_features


def test_what_cannot_be_predicted_is_refused(campaign: Campaign) -> None:
    """A content without cells, cement of another packing or of another content are told with a cure."""
    with pytest.raises(QueryError, match=r"content = 4 %.*Choose among 0"):
        campaign.predict(content=4.0)
    with pytest.raises(QueryError, match=r"network_conductance = \S+ is far from the .* of the samples at 5 %"):
        campaign.predict(content=5.0, pattern=campaign.cell(seed=2, content=0.66).cement)
    with pytest.raises(QueryError, match=r"level = 2\.0: is not a probability"):
        campaign.predict(content=5.0, level=2.0)
    strange = CementPattern(np.array([[0, 4000]]), np.array([1]), np.empty((0, 2)))
    with pytest.raises(QueryError, match="do not touch"):
        campaign.predict(content=5.0, pattern=strange)
    few = campaign.analyse()
    few.vs[4:] = np.nan  # of eight velocities
    with pytest.raises(QueryError, match="Compute at least 5 seeds"):
        predict_velocity(few, 5.0, campaign.cell(seed=2, content=5.0).cement)


def test_the_command_predicts_and_says_how_far_to_trust_it(
    campaign: Campaign, database: Path, tmp_path: Path, invoke: Callable[..., str]
) -> None:
    """A table over all contents, or one sample by seed or contacts, each with its check."""
    checks, alone = (check_predictions(campaign.analyse(), with_cement=used) for used in (True, False))
    assert 0.0 not in checks  # one packing, no cement: nothing scatters
    table = invoke("predict", database)
    assert all(f"{scores.mean():.1f}" in table for _, scores in (*checks.values(), *alone.values()))
    inside = np.concatenate([flags for flags, _ in checks.values()])
    told = f"Of {inside.size} samples, each predicted from the other seeds of its content, {100 * inside.mean():.1f} %"
    assert told in " ".join(table.split())
    cement = campaign.cell(seed=2, content=5.0).cement
    assert cement is not None
    contacts = tmp_path / "contacts.csv"
    contacts.write_text("first,second\n" + "".join(f"{a},{b}\n" for a, b in cement.contacts.tolist()), encoding="utf-8")
    one = " ".join(invoke("predict", database, "--content", 5, "--pattern", contacts).split())
    assert f"5 %: Vs {campaign.predict(content=5.0, pattern=cement).vs:.0f} m/s, 95 %" in one
    assert f"Mean interval score {checks[5.0][1].mean():.1f} m/s" in one
    assert f"{alone[5.0][1].mean():.1f} m/s for the content alone" in one
    by_content = " ".join(invoke("predict", database, "--content", 5).split())
    assert "from the content alone" in by_content
    assert f"{100 * alone[5.0][0].mean():.1f} % lay" in by_content
    assert f"Mean interval score {alone[5.0][1].mean():.1f} m/s. The" in by_content
    invoke("predict", database, "--content", 5, "--level", 0.9)
    invoke("predict", database, "--seed", 3, exit_code=2)
    invoke("predict", database, "--level", "nan", exit_code=2)
    invoke("predict", database, "--content", 5, "--seed", 3, "--pattern", contacts, exit_code=2)


def test_predictions_and_cells_that_depend_on_the_pulse_say_so(
    database: Path, tmp_path: Path, invoke: Callable[..., str]
) -> None:
    """As `status` and `report` do, at the contents with an effect above 2 % alone."""
    loud = Path(shutil.copy(database, tmp_path))
    with sqlite3.connect(loud) as connection:
        connection.execute("UPDATE result SET pulse_effect = 0.25 WHERE pulse_effect IS NOT NULL")
    cell = ("--seed", 3, "--content", 5)
    for words in (("predict", "--content", 5), ("query", *cell), ("show", *cell)):
        name, *options = words
        verdict = "depends on the pulse by more than 2 %"
        assert verdict in " ".join(invoke(name, loud, *options).split())
        assert verdict not in " ".join(invoke(name, database, *options).split())
