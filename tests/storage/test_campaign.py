"""Reading a campaign for analysis."""

import doctest
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from calcidem.app.campaign.opened import Campaign, open_campaign
from calcidem.ends import CellStatus
from calcidem.storage import records
from calcidem.storage.errors import QueryError, UnknownCampaignError, UnknownCellError
from calcidem.storage.records import STATUS_CODES
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Records


@pytest.fixture
def campaign(store: Store, open_here: Callable[..., Store], records: "Records") -> Campaign:
    """Open a campaign with outcomes of several kinds, one plan that isn't rectangular, and a packing."""
    store.extend((7,), (9.0,))
    store.save_packing(records.packing())
    store.record_results([records.with_arrays(0, 5.0), records.done(1, 5.0), records.done(7, 9.0)])
    store.record_results([records.failed(2, 5.0, status=CellStatus.NO_ARRIVAL)])
    reader = open_here(read_only=True)
    reader.use_campaign()
    return Campaign(reader)


def test_vs_is_labelled(campaign: Campaign) -> None:
    """Velocities come with seeds, contents and unit, NaN where not done."""
    vs = campaign.vs()
    assert vs.dims == ("seed", "content")
    assert vs.attrs["units"] == "m s-1"
    np.testing.assert_array_equal(vs.seed, [0, 1, 2, 3, 7])
    np.testing.assert_array_equal(vs.content, [0.0, 0.3, 5.0, 9.0])
    assert float(vs.sel(seed=1, content=5.0)) == 1151.0
    assert int(vs.count()) == 3


def test_dataset_tells_status_apart(campaign: Campaign) -> None:
    """Done, no arrival, pending and not planned are four different flags."""
    dataset = campaign.to_xarray()
    status = dataset["status"]
    assert status.sel(seed=0, content=5.0) == STATUS_CODES["done"]
    assert status.sel(seed=2, content=5.0) == STATUS_CODES["no_arrival"]
    assert status.sel(seed=3, content=5.0) == STATUS_CODES["pending"]
    assert status.sel(seed=3, content=9.0) == STATUS_CODES["not_planned"]
    assert status.attrs["flag_meanings"].split()[STATUS_CODES["done"]] == "done"
    assert dataset["reason"].sel(seed=2, content=5.0) == "the pick was not clear"
    assert np.isnan(dataset["vs"].sel(seed=2, content=5.0))
    np.testing.assert_array_equal(dataset["vs"], campaign.vs())


def test_select_gives_frozen_records(campaign: Campaign, records: "Records") -> None:
    """Selections give records with or without arrays, in order, for single values and lists."""
    assert [r.key.seed for r in campaign.select(content=5.0, status="done")] == [0, 1]
    assert [r.key.seed for r in campaign.select(seed=[0, 7], status=["done", "failed"])] == [0, 7]
    assert next(campaign.select(seed=np.int64(0), with_arrays=True)) == records.with_arrays(0, 5.0)
    assert campaign.cell(seed=0, content=5.0) == records.with_arrays(0, 5.0)
    with pytest.raises(QueryError):
        list(campaign.select(where="nonsense"))


def test_a_section_is_labelled(campaign: Campaign) -> None:
    """Times, places and both components of the motion come with their units."""
    stored = campaign.recorded_section(seed=0, content=5.0)
    found = campaign.section(seed=0, content=5.0)
    assert (found.dims, found.attrs["units"]) == (("time", "place", "component"), "m s-1")
    np.testing.assert_array_equal(found["place"], stored.places)
    np.testing.assert_array_equal(found.sel(component="across").isel(place=-1), stored.received)
    np.testing.assert_array_equal(found.sel(component="along"), stored.along * stored.resolution)


def test_missing_things_say_so(campaign: Campaign) -> None:
    """What isn't stored is an error that names it, never an empty object."""
    with pytest.raises(UnknownCellError, match="seed 1 and content"):
        campaign.section(seed=1, content=5.0)
    with pytest.raises(UnknownCellError, match="no outcome"):
        campaign.cell(seed=3, content=5.0)
    with pytest.raises(UnknownCellError, match="Packing 1"):
        campaign.packing(1)


def test_packing_config_and_runs(campaign: Campaign, records: "Records") -> None:
    """Packing, configuration and provenance are at hand."""
    assert campaign.packing() == records.packing()
    assert campaign.config["packing"]["friction"] == 0.2
    assert campaign.runs() == ()


def test_dataframe(campaign: Campaign) -> None:
    """The table has a row for each planned cell, whole numbers as such, and NA where nothing is known."""
    frame = campaign.to_dataframe()
    assert len(frame) == 13
    assert frame["steps"].dtype == "Int64"
    assert frame.loc[(frame["seed"] == 3) & (frame["content"] == 5.0), "steps"].isna().all()
    some = campaign.to_dataframe(["seed", "vs"], where="vs > 1150.5 and content = 5")
    pd.testing.assert_frame_equal(some, pd.DataFrame({"seed": pd.array([1], dtype="Int64"), "vs": [1151.0]}))
    with pytest.raises(QueryError, match="vss"):
        campaign.to_dataframe(["vss"])


def test_reader_sees_what_was_stored_since(campaign: Campaign, store: Store, records: "Records") -> None:
    """An open reader sees cells stored after it was opened."""
    store.record_results([records.done(3, 5.0)])
    assert float(campaign.vs().sel(seed=3, content=5.0)) == 1153.0


def test_campaign_is_chosen_by_name(store: Store, records: "Records", address: str) -> None:
    """Where there are several campaigns one is opened by name, and an unknown name lists them."""
    store.begin_campaign(records.campaign({"x": 1}, name="second"))
    with open_campaign(address, "second") as campaign:
        assert campaign.config == {"x": 1}
    with pytest.raises(UnknownCampaignError, match="'quick', 'second'"):
        open_campaign(address, "third")


@pytest.mark.parametrize("module", [records])
def test_examples_of_the_documentation(module: ModuleType) -> None:
    """The examples in the docstrings give what they show."""
    result = doctest.testmod(module)
    assert result.attempted > 0
    assert result.failed == 0
