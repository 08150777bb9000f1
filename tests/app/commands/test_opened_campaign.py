"""The Python API on a small real database."""

import doctest
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import calcidem.dem
from calcidem.analysis.distribution import Distribution
from calcidem.app.campaign import opened as opened_campaign
from calcidem.app.campaign.opened import Campaign, open_campaign
from calcidem.app.campaign.packing import with_patterns
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.cement import GIVEN, CementKind
from calcidem.dem.wave.experiment import Experiment
from calcidem.storage.errors import StoreError, UnknownCellError
from calcidem.storage.netcdf import export_netcdf, import_netcdf
from calcidem.storage.records import Selection, canonical_json
from calcidem.storage.sql.store import Store

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("seed", [1, 5])
def test_a_rebuilt_sample_is_the_one_that_was_computed(campaign: Campaign, seed: int) -> None:
    """The sample from the store has the cement that drawing it anew from its seed gives, contact by contact."""
    sample = campaign.sample(seed=seed, content=5.0)
    drawn = campaign.experiment().ordering(seed).at(5.0)
    np.testing.assert_array_equal(sample.kind, drawn.kind)
    stored = campaign.cell(seed=seed, content=5.0)
    assert (stored.p_contacts, stored.clusters) == (drawn.p_contacts, drawn.clusters)
    assert sample.bonds is not None
    assert len(sample.bonds.pairs) == stored.bonded_contacts


@pytest.mark.full
@pytest.mark.parametrize("content", [0.0, 0.66])
def test_a_rebuilt_sample_is_in_balance(campaign: Campaign, content: float) -> None:
    """The disks, forces and walls that come back are those of a packing at rest, with cement or without."""
    sample = campaign.sample(seed=1, content=content)
    state = calcidem.dem.start(sample.scene, preload=sample.packing.preload)
    # Servo and friction of the packing stage are gone; what is left out of balance is that of the packing's report.
    assert calcidem.dem.unbalanced_ratio(state) < 1e-4


def test_a_sample_without_cement_has_no_bonds(campaign: Campaign) -> None:
    """At 0 % no contact is cemented."""
    sample = campaign.sample(seed=1, content=0.0)
    assert sample.bonds is None
    assert set(sample.kind.tolist()) == {CementKind.NONE}


def test_cement_that_is_not_stored_is_drawn_as_it_was(campaign: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    """Taken off, it comes back from the seed, array by array; not where the drawn one would be another."""
    stored = list(campaign.store.results(Selection((1, 5)), with_arrays=True))
    assert len(stored) > 4
    without = [replace(cell, cement=None) for cell in stored]
    assert list(with_patterns(campaign.store, without)) == stored
    other = replace(without[-1], p_contacts=1 + (without[-1].p_contacts or 0))
    never = replace(without[-1], bonded_contacts=None)
    assert list(with_patterns(campaign.store, [other, never])) == [other, never]
    physics = canonical_json(campaign.config | {"physics_version": 0})
    monkeypatch.setattr(campaign.store, "_record", replace(campaign.record, config=physics))
    assert list(with_patterns(campaign.store, without)) == without


def test_only_a_pattern_that_no_package_has_leaves_cells_without_cement(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pattern that is not installed cannot draw it; one that gives no order is an error, not a missing pattern."""
    without = [replace(cell, cement=None) for cell in campaign.store.results(Selection(1, 5), with_arrays=True)]
    config = campaign.config | {"pattern": campaign.config["pattern"] | {"drawn_by": "own"}}
    monkeypatch.setattr(campaign.store, "_record", replace(campaign.record, config=canonical_json(config)))
    assert list(with_patterns(campaign.store, without)) == without
    monkeypatch.setitem(GIVEN, "own", lambda points, _: np.arange(len(points) - 1))
    with pytest.raises(ValueError, match="no permutation"):
        list(with_patterns(campaign.store, without))


def test_an_export_without_cement_is_analysed_like_the_database(campaign: Campaign, tmp_path: Path) -> None:
    """Of what `calcidem import` makes of it the samples have the same contacts, paths and features."""
    export_netcdf(campaign.store, tmp_path / "short.nc", without=("section", "cement", "path"))
    with Store(tmp_path / "short.db") as store:
        import_netcdf(tmp_path / "short.nc", store)
    with open_campaign(tmp_path / "short.db") as short:
        pairs = list(zip(short.analyse().samples, campaign.analyse().samples, strict=True))
    assert all(one.kinds.tobytes() == other.kinds.tobytes() for one, other in pairs)
    assert all(one.features.path_connectivity == other.features.path_connectivity for one, other in pairs)


def test_summary_is_the_distribution(campaign: Campaign) -> None:
    """The summary of a content describes the velocities that `vs` gives."""
    row = campaign.summary().sel(content=5.0)
    expected = Distribution.of_sample(campaign.vs().sel(content=5.0).dropna("seed"))
    assert float(row["mean"]) == expected.mean
    assert float(row["skewness"]) == expected.skewness
    assert row["prediction_interval"].values.tolist() == [
        expected.prediction_interval.low,
        expected.prediction_interval.high,
    ]


def test_a_campaign_says_what_it_is(campaign: Campaign) -> None:
    """At the prompt there are name, size and outcomes, in a notebook also the mean of every content."""
    seeds, contents = len(campaign.record.seeds), len(campaign.record.contents)
    assert f"'{campaign.record.name}': {seeds} seeds x {contents} contents; cells: " in repr(campaign)
    page = campaign._repr_html_()
    assert all(f"<td>{mean:.1f}</td>" in page for mean in campaign.summary()["mean"].values)


def test_graph_agrees_with_the_stored_summary(campaign: Campaign) -> None:
    """The networkx graph has the contacts, bonds and components that are stored with the cell."""
    import networkx as nx  # noqa: PLC0415 - this test alone needs it

    graph, stored = campaign.graph(seed=2, content=2.55), campaign.cell(seed=2, content=2.55).network
    assert stored is not None
    bonds = [(a, b) for a, b, bonded in graph.edges(data="bonded") if bonded]
    cement = nx.Graph(bonds)
    assert 2 * len(bonds) / cement.number_of_nodes() == stored.network_coordination_number
    sizes = [len(component) for component in nx.connected_components(cement)]
    assert (len(sizes), max(sizes)) == (stored.network_components, stored.network_largest_component)
    lengths = nx.multi_source_dijkstra_path_length(
        graph,
        {grain for grain, role in graph.nodes(data="role") if role == "transmitter"},
        weight=lambda _first, _second, data: 0 if data["bonded"] else 1,
    )
    receivers = [grain for grain, role in graph.nodes(data="role") if role == "receiver"]
    assert min(lengths[grain] for grain in receivers) == stored.network_gap_contacts


def test_experiment_survives_the_database(campaign: Campaign) -> None:
    """The experiment from the stored configuration is that of the file it was computed from."""
    from calcidem.app.config.reader import load_configuration  # noqa: PLC0415 - this test alone needs it

    configuration = load_configuration(Path(__file__).parents[3] / "docs" / "tutorial" / "quick.toml", {})
    stored = campaign.experiment()
    given = configuration.experiment(stored.packing)
    names = [field.name for field in fields(Experiment) if field.name != "packing"]
    assert {name: getattr(stored, name) for name in names} == {name: getattr(given, name) for name in names}


def test_what_is_missing_is_said(campaign: Campaign) -> None:
    """An unknown cell and an incomplete configuration are refused with their names."""
    with pytest.raises(UnknownCellError, match="seed 99"):
        campaign.sample(seed=99, content=5.0)
    with pytest.raises(UnknownCellError, match=r"no content 1.5 % in campaign .* There are 0, .*9 %"):
        campaign.cell(seed=1, content=1.5)
    with pytest.raises(StoreError, match="lacks root_seed, sand"):
        Configuration.from_physics({"wave": {}})


@pytest.mark.full
def test_examples_of_the_documentation(database: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The examples in the docstrings give what they show."""
    monkeypatch.chdir(database.parent)
    result = doctest.testmod(opened_campaign)
    assert result.attempted > 0
    assert result.failed == 0
