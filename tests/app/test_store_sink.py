"""The sink of a run: what other processes do to the database costs time, and no result."""

from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calcidem.app.campaign.cells import batches_of
from calcidem.app.campaign.run import StoreSink, describe_run
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.app.config.schema import Configuration
from calcidem.ends import CellStatus
from calcidem.storage.errors import StoreLockedError
from calcidem.storage.records import AttemptCount, CampaignRecord, CellKey, CellResult, Selection, canonical_hash
from calcidem.storage.sql.store import Store
from calcidem.sweep.schedule import EXIT_RESUMABLE, Batch, BatchOutcome
from calcidem.wording import listening


class OftenLockedStore(Store):
    """A store that another process has locked a few times."""

    locked = 0

    def record_running(self, keys: Iterable[CellKey]) -> dict[CellKey, AttemptCount]:
        """Fail as long as it is locked."""
        if self.locked:
            self.locked -= 1
            raise StoreLockedError("database is locked.", "Try again.")
        return super().record_running(keys)


@pytest.mark.slow
def test_a_lock_is_waited_for_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is dropped while another process has locked the database, and it is said why nothing happens."""
    monkeypatch.setattr("calcidem.app.campaign.run.time.sleep", lambda _: None)
    told: list[tuple[str, bool]] = []
    with OftenLockedStore(tmp_path / "one.db") as store:
        store.begin_campaign(CampaignRecord(canonical_hash({}), "one", "{}", (5.0,), (1,), datetime.now(UTC)))
        sink = StoreSink(store, [CellKey(1, 5.0)])
        store.locked = 3
        with listening(lambda text: told.append((text, sink.busy.locked()))):
            sink.mark([Batch(((1, 5.0),), 1.0)])
        assert store.attempt_counts([CellKey(1, 5.0)])[CellKey(1, 5.0)] == AttemptCount(1, 0)
        assert len(told) == 3
        assert "Waiting for another process that has locked the database" in told[0][0]
        assert all(is_busy for _, is_busy in told)
        sink.patience = 0.0
        store.locked = 100
        with pytest.raises(StoreLockedError) as refused:
            sink.mark([Batch(((2, 5.0),), 1.0)])
    assert _exit_code_of(refused.value) == EXIT_RESUMABLE


PLAN = CampaignRecord(canonical_hash({}), "one", "{}", (5.0,), (1, 2), datetime.now(UTC))
KEYS = [CellKey(1, 5.0), CellKey(2, 5.0)]
BATCH = Batch(((1, 5.0), (2, 5.0)))
NUMBERS = {"frequency": 15e3, "time_step": 8e-8, "stability_limit": 1e-7, "steps": 9}


def outcome_of(*keys: CellKey) -> BatchOutcome[tuple[int, float], CellResult]:
    """Outcome of cells that are done."""
    results = tuple(CellResult(key, CellStatus.DONE, vs=900.0, **NUMBERS).pack() for key in keys)
    return BatchOutcome(Batch(tuple((key.seed, key.content) for key in keys)), 1.0, results, rank=1, host="here")


def test_a_cell_that_was_computed_when_a_run_died_has_lost_an_attempt(tmp_path: Path) -> None:
    """The next run counts it; a cell with an outcome, marked twice on the way, has one attempt and no loss."""
    with Store(tmp_path / "one.db") as store:
        store.begin_campaign(PLAN)
        store.begin_run(describe_run(3))
        sink = StoreSink(store, KEYS)
        sink.mark([BATCH])
        sink.mark([Batch(BATCH.cells[:1])])  # computed again alone, after an exception of the batch
        sink.store([outcome_of(KEYS[0])])
        assert set(store.attempt_counts(KEYS).values()) == {AttemptCount(1, 0)}
    with Store(tmp_path / "one.db") as store:
        store.use_campaign("one")
        store.begin_run(describe_run(3))
        assert StoreSink(store, KEYS).losses == {(1, 5.0): 0, (2, 5.0): 1}
        assert [(attempt.key, attempt.outcome) for attempt in store.history()] == [(KEYS[0], "done"), (KEYS[1], "lost")]


@pytest.mark.parametrize("cut_off", [False, True])
def test_a_run_that_was_stopped_blames_no_cell(tmp_path: Path, cut_off: bool) -> None:
    """At an end by a signal, cells without an outcome had no attempt; a run cut off by a death keeps their marks."""
    with Store(tmp_path / "one.db") as store:
        store.begin_campaign(PLAN)
        store.begin_run(describe_run(3))
        sink = StoreSink(store, KEYS)
        sink.mark([BATCH])
        sink.store([outcome_of(KEYS[0])])
        store.end_run("stopped", datetime.now(UTC), cut_off=cut_off)
        store.begin_run(describe_run(3))
        counts = store.attempt_counts(KEYS)
        assert counts == {KEYS[0]: AttemptCount(1, 0), KEYS[1]: AttemptCount(1, 1) if cut_off else AttemptCount(0, 0)}


def test_the_sample_without_cement_is_computed_once(tmp_path: Path) -> None:
    """One batch has it; all seeds get its outcome, those of a later run too, and SQL tells which were not computed."""
    configuration = Configuration()
    assert batches_of(configuration, [(seed, 0.0) for seed in (3, 1, 2)])[0].cells == ((1, 0.0),)
    bare = [CellKey(seed, 0.0) for seed in (1, 2, 3)]
    with Store(tmp_path / "one.db") as store:
        store.begin_campaign(replace(PLAN, contents=(0.0, 5.0)))
        store.begin_run(describe_run(3))
        sink = StoreSink(store, [*bare[:2], *KEYS])
        assert sink.repeat_stored() == set()
        sink.store([outcome_of(bare[0])])
        store.plan([bare[2]])
        assert StoreSink(store, [bare[2], *KEYS]).repeat_stored() == {bare[2]}
        found = list(store.results(Selection(contents=0.0)))
        assert [(cell.vs, cell.steps, cell.attempt) for cell in found] == 3 * [(900.0, 9, 1)]
        rows = store.table(("host", "seconds", "reason"), Selection(contents=0.0))
        assert rows["host"].tolist() == ["here", None, None]
        assert np.isfinite(rows["seconds"].astype(float)).tolist() == [False, False, False]
        assert rows["reason"][1:].tolist() == 2 * ["without cement all seeds are one sample, computed as seed 1"]


@pytest.mark.parametrize("failed", [CellStatus.FAILED, CellStatus.NO_ARRIVAL])
def test_a_sample_without_cement_that_fails_fails_for_all_seeds(tmp_path: Path, failed: CellStatus) -> None:
    """No other seed of it is tried; after a retry it is computed again, unless physics decided the outcome."""
    bare = [CellKey(seed, 0.0) for seed in (1, 2)]
    with Store(tmp_path / "one.db") as store:
        store.begin_campaign(replace(PLAN, contents=(0.0,)))
        store.begin_run(describe_run(3))
        outcome = CellResult(bare[0], failed, "an error", **NUMBERS).pack()
        StoreSink(store, bare).store([replace(outcome_of(bare[0]), results=(outcome,))])
        assert {cell.status for cell in store.results()} == {failed}
        store.retry([failed], [bare[1]])
        assert StoreSink(store, bare[1:]).repeat_stored() == ({bare[1]} - ({bare[1]} if failed == "failed" else set()))
