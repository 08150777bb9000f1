"""The sink of a run: what other processes do to the database costs time, and no result."""

from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from calcidem.app.campaign import store_sink
from calcidem.app.campaign.store_sink import StoreSink
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.storage.errors import StoreLockedError
from calcidem.storage.records import AttemptCount, CampaignRecord, CellKey
from calcidem.storage.records.canonical import canonical_hash
from calcidem.storage.sql.store import Store
from calcidem.sweep.batch import Batch
from calcidem.sweep.sweep_end import EXIT_RESUMABLE


class OftenLockedStore(Store):
    """A store that another process has locked a few times."""

    locked = 0

    def record_lost(self, keys: Iterable[CellKey], reason: str) -> dict[CellKey, AttemptCount]:
        """Fail as long as it is locked."""
        if self.locked:
            self.locked -= 1
            raise StoreLockedError("database is locked.", "Try again.")
        return super().record_lost(keys, reason)


@pytest.mark.slow
def test_a_lock_is_waited_for_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is dropped while another process has locked the database, and it is said why nothing happens."""
    monkeypatch.setattr(store_sink, "_LOCK_PAUSE", 0.0)
    told: list[tuple[str, bool]] = []
    with OftenLockedStore(tmp_path / "one.db") as store:
        store.begin_campaign(CampaignRecord(canonical_hash({}), "one", "{}", (5.0,), (1,), datetime.now(UTC)))
        sink = StoreSink(store, [CellKey(1, 5.0)], lambda text: told.append((text, sink.busy.locked())))
        store.locked = 3
        sink.store_loss(Batch(0, ((1, 5.0),), 1.0), "killed")
        assert store.attempt_counts()[CellKey(1, 5.0)] == AttemptCount(1, 1)
        assert len(told) == 3
        assert "Waiting for another process that has locked the database" in told[0][0]
        assert all(is_busy for _, is_busy in told)
        monkeypatch.setattr(store_sink, "_MOST_PATIENCE", 0.0)
        store.locked = 100
        with pytest.raises(StoreLockedError) as refused:
            sink.store_loss(Batch(0, ((1, 5.0),), 1.0), "killed")
    assert _exit_code_of(refused.value) == EXIT_RESUMABLE
