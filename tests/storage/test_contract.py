"""The contract of `Store`, run on every implementation."""

import dataclasses
import os
import socket
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np
import pytest
from sqlalchemy import text

from calcidem.ends import CellStatus
from calcidem.storage.errors import (
    CampaignMismatchError,
    InvalidRecordError,
    LeaseHeldError,
    LeaseLostError,
    QueryError,
    ReadOnlyStoreError,
    UnknownCampaignError,
    UnknownCellError,
)
from calcidem.storage.records import STORED_STATUSES, AttemptCount, CellKey, Selection, canonical_json
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Records

NUMBER_OF_CELLS = 12  # 4 seeds x 3 contents, see conftest


def test_new_campaign_is_pending(store: Store) -> None:
    """All planned cells of a new campaign are pending, by seed, then content."""
    assert store.pending() == tuple(CellKey(seed, content) for seed in range(4) for content in (0.0, 0.3, 5.0))


def test_continue_keeps_outcomes(store: Store, open_here: Callable[..., Store], records: "Records") -> None:
    """Beginning the same campaign again continues it: what was done is not pending."""
    store.record_results([records.done(1, 5.0)])
    again = open_here()
    assert again.begin_campaign(records.campaign(created=datetime.now(UTC))) == records.campaign()
    assert len(again.pending()) == NUMBER_OF_CELLS - 1


def test_changed_config_is_refused_with_difference(store: Store, records: "Records") -> None:
    """A changed configuration under the same name is refused, naming the nested key and both values."""
    changed = records.campaign({"packing": {"friction": 0.5}, "wave": {"v0": 1e-5}})
    with pytest.raises(CampaignMismatchError, match=r"packing\.friction: 0\.2 -> 0\.5") as refusal:
        store.begin_campaign(changed)
    assert "v0" not in str(refusal.value)
    assert store.campaigns() == (records.campaign(),)


def test_a_hash_stands_for_one_value_of_each_key(store: Store, records: "Records") -> None:
    """Of two configurations with one hash, one may lack a key of the other; a key of both has one value."""
    stored = records.campaign()
    later = {"packing": {"friction": 0.2}, "wave": {"v0": 1e-5, "later": 3}}
    assert store.begin_campaign(dataclasses.replace(stored, config=canonical_json(later))) == stored
    changed_default = {"packing": {"friction": 0.2}, "wave": {"v0": 2e-5}}
    with pytest.raises(CampaignMismatchError, match=r"wave\.v0: 1e-05 -> 2e-05"):
        store.begin_campaign(dataclasses.replace(stored, config=canonical_json(changed_default)))


def test_several_campaigns_share_a_store(store: Store, records: "Records") -> None:
    """Campaigns of different names live side by side, and each sees its own cells only."""
    store.record_results([records.done(1, 5.0)])
    store.begin_campaign(records.campaign({"other": 1}, name="other"))
    assert len(store.pending()) == NUMBER_OF_CELLS
    with pytest.raises(UnknownCampaignError, match="2 campaigns"):
        store.use_campaign()
    assert store.use_campaign("quick").name == "quick"
    assert len(store.pending()) == NUMBER_OF_CELLS - 1


def test_extension_adds_cells_only(store: Store, records: "Records") -> None:
    """More seeds and contents extend the plan and leave outcomes alone; the union of plans is reported."""
    store.record_results([records.done(1, 5.0)])
    extended = store.begin_campaign(records.campaign(seeds=(3, 4, 5), contents=(5.0, 9.0)))
    assert extended.seeds == (0, 1, 2, 3, 4, 5)
    assert extended.contents == (0.0, 0.3, 5.0, 9.0)
    assert len(store.pending()) == NUMBER_OF_CELLS - 1 + 5
    assert store.extend((0,), (9.0,)) == 1
    assert store.extend((0,), (9.0,)) == 0


def test_pending_is_limited_to_what_is_asked(store: Store) -> None:
    """Seeds and contents limit what is pending, and contents are found whatever their last bits are."""
    assert store.pending(seeds=(2,), contents=(0.1 + 0.2,)) == (CellKey(2, 0.3),)
    assert store.pending(seeds=(0, 3), contents=(5.0,)) == (CellKey(0, 5.0), CellKey(3, 5.0))


def test_storing_twice_gives_one_row(store: Store, records: "Records") -> None:
    """The same result stored twice, also within one call, changes nothing the second time."""
    result = records.with_arrays(1, 5.0)
    assert store.record_results([result, result]) == 1
    before = list(store.history())
    assert store.record_results([result]) == 0
    assert list(store.results(with_arrays=True)) == [result]
    assert list(store.history()) == before


def test_repeated_failure_gives_one_attempt(store: Store, records: "Records") -> None:
    """A failed outcome stored twice with the same attempt number counts as one attempt."""
    for _ in range(2):
        store.record_results([records.failed(1, 5.0)])
    assert store.attempt_counts([CellKey(1, 5.0)]) == {CellKey(1, 5.0): AttemptCount(1, 0)}


def test_done_is_never_replaced(store: Store, records: "Records") -> None:
    """A done cell survives later outcomes."""
    store.record_results([records.done(1, 5.0, vs=1000.0)])
    assert store.record_results([records.failed(1, 5.0, attempt=2), records.done(1, 5.0, vs=1.0, attempt=3)]) == 0
    assert next(store.results()).vs == 1000.0


def test_later_attempt_replaces_other_outcomes(store: Store, records: "Records") -> None:
    """An outcome other than done gives way to a later attempt and to a done one, not to an older failure."""
    store.record_results([records.failed(1, 5.0, attempt=2)])
    assert store.record_results([records.failed(1, 5.0, status=CellStatus.UNSTABLE, attempt=1)]) == 0
    assert store.record_results([records.failed(1, 5.0, status=CellStatus.UNSTABLE, attempt=3)]) == 1
    assert store.statuses()[CellKey(1, 5.0)] is CellStatus.UNSTABLE
    assert store.record_results([records.done(1, 5.0, attempt=1)]) == 1
    assert store.statuses()[CellKey(1, 5.0)] is CellStatus.DONE


def test_cell_round_trip(store: Store, records: "Records") -> None:
    """Everything of a cell comes back as given; without arrays only path, section and cement are left out."""
    given = [records.with_arrays(seed, content) for seed in range(4) for content in (0.0, 5.0)]
    given.append(records.failed(2, 0.3, status=CellStatus.NO_ARRIVAL))
    store.record_results(reversed(given))
    in_order = sorted(given, key=lambda result: result.key)
    assert list(store.results(with_arrays=True)) == in_order
    assert list(store.results()) == [dataclasses.replace(r, path=None, section=None, cement=None) for r in in_order]


def test_unplanned_cell_is_refused_as_a_whole(store: Store, records: "Records") -> None:
    """A batch with an unplanned cell is refused, and nothing of it is stored."""
    with pytest.raises(UnknownCellError, match="Seed 9"):
        store.record_results([records.done(1, 5.0), records.done(9, 5.0)])
    assert list(store.results()) == []


def test_every_outcome_settles_until_retry(store: Store, records: "Records") -> None:
    """All outcomes settle their cells; retry brings back failed and timed_out, and others on request."""
    outcomes = [s for s in STORED_STATUSES if s is not CellStatus.DONE]
    keys = [(seed, content) for seed in range(2) for content in (0.0, 0.3, 5.0)]
    store.record_results([records.failed(*key, status=status) for key, status in zip(keys, outcomes, strict=False)])
    assert len(store.pending()) == NUMBER_OF_CELLS - len(outcomes)
    retried = store.retry()
    assert len(retried) == 2
    assert set(retried) <= set(store.pending())
    assert len(store.retry([CellStatus.QUARANTINED])) == 1
    assert store.retry(keys=[CellKey(3, 5.0)]) == ()
    with pytest.raises(ValueError, match="done can't be retried"):
        store.retry([CellStatus.DONE])


def test_losses_are_counted_over_restarts_and_forgiven_by_retry(
    store: Store, open_here: Callable[..., Store], records: "Records"
) -> None:
    """Lost attempts count up over several openings of the store, take numbers, and a retry forgets them."""
    key = CellKey(1, 5.0)
    for losses in (1, 2, 3):
        again = open_here()
        again.use_campaign()
        again.begin_run(records.run())
        assert again.record_running([key]) == {key: AttemptCount(losses, losses - 1)}
    store.begin_run(records.run())
    assert store.attempt_counts([key]) == {key: AttemptCount(3, 3)}
    assert key in store.pending()
    store.record_results([records.failed(1, 5.0, status=CellStatus.QUARANTINED, attempt=4)])
    store.retry([CellStatus.QUARANTINED])
    assert store.attempt_counts() == {key: AttemptCount(4, 0)}
    assert [(a.number, a.outcome, a.forgiven) for a in store.history()] == [
        (1, "lost", True),
        (2, "lost", True),
        (3, "lost", True),
        (4, "quarantined", True),
    ]


def test_attempts_belong_to_runs(store: Store, records: "Records") -> None:
    """Attempts recorded during a run carry its number, and the run keeps its provenance and end."""
    number = store.begin_run(records.run())
    store.record_results([records.done(1, 5.0)])
    ended = records.run().started + timedelta(hours=2)
    store.end_run("complete", ended)
    assert [attempt.run_id for attempt in store.history()] == [number]
    assert store.runs() == ((number, records.run(ended=ended, exit_state="complete")),)


def test_packing_round_trip(store: Store, records: "Records") -> None:
    """Packings come back bit for bit; saving one again is harmless, another under its index is refused."""
    for index in (1, 0, 0):
        store.save_packing(records.packing(index))
    assert store.packing_indices() == (0, 1)
    assert store.packing(1) == records.packing(1)
    with pytest.raises(UnknownCellError, match="Packing 2"):
        store.packing(2)
    with pytest.raises(CampaignMismatchError, match="hash"):
        store.save_packing(records.packing(0, hash="another"))


def test_another_packing_of_the_same_origin_is_refused(store: Store, records: "Records") -> None:
    """Another content hash is another packing, whatever it was made from; the error names both."""
    store.save_packing(records.packing(content_hash="mine"))
    with pytest.raises(CampaignMismatchError, match=r"content hash mine .* and yours "):
        store.save_packing(records.packing(content_hash="yours"))
    assert store.packing() == records.packing(content_hash="mine")
    assert store.content_hashes() == {0: "mine"}


def test_status_counts(store: Store, records: "Records") -> None:
    """Counts by content and status add up to the plan."""
    store.record_results([records.done(0, 5.0), records.done(1, 5.0), records.failed(2, 5.0)])
    counts = store.status_counts()
    assert counts[5.0, CellStatus.DONE] == 2
    assert counts[5.0, CellStatus.FAILED] == 1
    assert counts[5.0, CellStatus.PENDING] == 1
    assert sum(counts.values()) == NUMBER_OF_CELLS


@pytest.mark.parametrize(
    ("selection", "count"),
    [
        (Selection(contents=(5.0,)), 4),
        (Selection(seeds=(0, 2)), 4),
        (Selection(seeds=range(0, 100_000, 2)), 4),  # more than a statement may have parameters
        (Selection(statuses=(CellStatus.FAILED,)), 1),
        (Selection(where="vs > 1150 and content == 5"), 3),
        (Selection(where="not (status = 'done') or seed in (0, 1)"), 5),
        (Selection(where="200 < vs <= 1152"), 3),
        (Selection(where="vs is None"), 1),
        (Selection(where="path_contacts is not None"), 0),
    ],
)
def test_selection(store: Store, records: "Records", selection: Selection, count: int) -> None:
    """Selections by seed, content, status and expression find the cells they describe."""
    store.record_results(records.done(seed, content) for seed in range(4) for content in (0.0, 5.0))
    store.retry(keys=())
    store.record_results([records.failed(3, 0.3)])
    assert len(list(store.results(selection))) == count


def test_derived_quantities_are_those_of_the_records(store: Store, records: "Records") -> None:
    """The total error can be selected, sorted by and fetched as in the records; cells of an older version lack it."""
    store.record_results(
        [
            records.done(0, 5.0, reading_error=0.03, numerical_error=0.04, pulse_effect=0.0),
            records.done(1, 5.0, reading_error=0.03, numerical_error=0.04, pulse_effect=0.12),
            records.done(2, 5.0, reading_error=None),
        ]
    )
    found = store.table(("seed", "vs_error"), Selection(contents=(5.0,)), sort=("-vs_error",))
    assert found["seed"].tolist() == [1, 0, 2, 3]
    assert found["vs_error"][:2] == pytest.approx([0.13, 0.05])
    assert np.isnan(found["vs_error"][2:]).all()
    (marked,) = store.results(Selection(where="vs_error > 0.1"))
    assert marked.key.seed == 1
    assert marked.vs_error == found["vs_error"][0]
    half = 1.96 * 1151.0 * marked.vs_error
    assert marked.vs_interval == pytest.approx((1151.0 - half, 1151.0 + half))
    assert len(list(store.results(Selection(where="vs_error is None", statuses=(CellStatus.DONE,))))) == 1


@pytest.mark.parametrize(
    ("where", "hint"),
    [
        ("vss > 3", "Did you mean 'vs'"),
        ("vs > 3; DROP TABLE cell", "can't be read"),
        ("__import__('os').system('true')", "not a comparison"),
        ("vs > (1).bit_length()", "neither quantity"),
        ("vs > {[]}", "neither quantity"),
        ("vs", "not a comparison"),
        ("vs in 3", "needs a list"),
        ("vs is 3", "None only"),
        ("vs > True", "neither quantity"),
        ("", "can't be read"),
    ],
)
def test_wrong_expressions_are_refused(store: Store, where: str, hint: str) -> None:
    """An expression that isn't made of comparisons of quantities is refused with advice."""
    with pytest.raises(QueryError, match=hint.replace("(", r"\(")):
        list(store.results(Selection(where=where)))


def test_quoted_text_stays_data(store: Store, records: "Records") -> None:
    """SQL inside a quoted word is only a word that nothing equals."""
    store.record_results([records.done(1, 5.0)])
    assert list(store.results(Selection(where="host == \"x' OR '1'='1\""))) == []


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE result SET vs = NULL",
        "UPDATE result SET vs = -1",
        "UPDATE result SET vs = 1e308 * 10",
        "UPDATE result SET status = 'failed'",
        "UPDATE result SET status = 'wonderful'",
        "UPDATE result SET time_step = 0",
        "UPDATE result SET steps = NULL",
        "UPDATE result SET attempt = 7",
        "UPDATE cell SET content = 101",
        "UPDATE cell SET seed = -1",
        "DELETE FROM attempt",
        "INSERT INTO cell (campaign_id, seed, content) SELECT campaign_id, seed, content FROM cell",
        "UPDATE result SET path_contacts = 99",
        "UPDATE arrays SET name = 'picture'",
        "UPDATE result SET network_components = -1",
    ],
)
def test_schema_refuses_nonsense(store: Store, records: "Records", statement: str) -> None:
    """The database itself refuses numbers and statuses that contradict each other, whoever writes them."""
    store.record_results([records.with_arrays(1, 5.0)])
    with pytest.raises(InvalidRecordError), store._writing() as session:
        session.execute(text(statement))
    assert list(store.results(with_arrays=True)) == [records.with_arrays(1, 5.0)]


def test_read_only_store_refuses_writes(store: Store, open_here: Callable[..., Store], records: "Records") -> None:
    """A store opened for reading reads, and refuses to write."""
    store.record_results([records.done(1, 5.0)])
    reader = open_here(read_only=True)
    reader.use_campaign()
    assert list(reader.results()) == [records.done(1, 5.0)]
    with pytest.raises(ReadOnlyStoreError):
        reader.record_results([records.done(2, 5.0)])


def test_a_database_that_refuses_writes_is_named(open_here: Callable[..., Store], store: Store) -> None:
    """What SQLite and PostgreSQL say of a write that they do not allow becomes this error, with what to do."""
    del store  # its database is there
    writer = open_here()
    of_server = "SET SESSION CHARACTERISTICS AS TRANSACTION READ ONLY"
    with writer._writing() as session:
        session.execute(text(of_server if writer.address.path is None else "PRAGMA query_only = 1"))
    with pytest.raises(ReadOnlyStoreError, match="permissions"), writer._writing() as session:
        session.execute(text("DELETE FROM calcidem_schema"))


def test_lease_is_granted_once_and_can_be_asked_for_again(store: Store) -> None:
    """Asking again for a held lease gives the same one; released, it is free for a new one."""
    assert store.acquire_lease() == ()
    holder = store.lease_holder()
    assert holder is not None
    assert store.acquire_lease() == ()
    renewed = store.lease_holder()
    assert renewed is not None
    assert renewed.acquired == holder.acquired
    store.release_lease()
    assert store.lease_holder() is None
    assert store.acquire_lease() == ()


def test_lease_holder_is_known_to_readers(store: Store, open_here: Callable[..., Store]) -> None:
    """Whoever reads sees which process holds the lease, whether it may be alive, and nobody after its release."""
    reader = open_here(read_only=True)
    reader.use_campaign()
    assert reader.lease_holder() is None
    store.acquire_lease()
    holder = reader.lease_holder()
    assert holder is not None
    assert (holder.host, holder.pid) == (socket.gethostname(), os.getpid())
    assert holder.may_live()
    assert not dataclasses.replace(holder, heartbeat=holder.heartbeat - timedelta(minutes=6)).may_live()
    assert not dataclasses.replace(holder, pid=2**22 + 1).may_live()
    assert not dataclasses.replace(holder, started="1").may_live()  # its number was given to another process
    assert dataclasses.replace(holder, machine="elsewhere", pid=2**22 + 1).may_live()
    store.release_lease()
    assert reader.lease_holder() is None


def test_a_master_writes_together_and_nobody_beside_it(store: Store, open_here: Callable[..., Store]) -> None:
    """Several writes become one transaction in the process that has the lease, elsewhere only after its release."""
    other = open_here()
    store.acquire_lease()
    holder = store.lease_holder()
    assert holder is not None
    said = f"process {os.getpid()} .* ends at {holder.heartbeat + timedelta(minutes=5):%H:%M:%S} UTC"
    with pytest.raises(LeaseHeldError, match=said), other.together():
        pass
    with store.together():
        store.renew_lease()
    store.release_lease()
    with other.together():
        pass


def test_master_that_lost_its_lease_writes_nothing(store: Store, records: "Records") -> None:
    """Once another process has the lease, recording and heartbeats of the former master are refused."""
    store.acquire_lease()
    store.renew_lease()
    with store._writing() as session:
        session.execute(text("UPDATE lease SET token = 'of another process'"))
    with pytest.raises(LeaseLostError, match="taken this campaign over"):
        store.record_results([records.done(1, 5.0)])
    with pytest.raises(LeaseLostError):
        store.renew_lease()
    assert list(store.results()) == []


def test_methods_need_a_campaign(open_here: Callable[..., Store]) -> None:
    """Without a chosen campaign there is nothing to ask, and the error says what to call."""
    with pytest.raises(UnknownCampaignError, match="begin_campaign"):
        open_here().pending()
