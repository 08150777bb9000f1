"""`calcidem retry`: cells that went wrong become pending again, and nothing else does."""

from collections.abc import Callable
from pathlib import Path

import pytest

from calcidem.app.campaign.retry import retry_cells
from calcidem.storage.errors import LeaseHeldError, StoreUnavailableError, UnknownCellError
from calcidem.storage.records import CellKey, CellStatus
from calcidem.storage.sql.store import open_store
from calcidem.storage.store import Selection

PENDING_BEFORE = 6


def pending(database: Path) -> set[CellKey]:
    """Pending cells of a database."""
    with open_store(database, read_only=True) as store:
        store.use_campaign()
        return set(store.pending())


def test_failed_and_timed_out_cells_are_retried_by_default(troubled: Path, invoke: Callable[..., str]) -> None:
    """Without options the failed and the timed-out cell become pending, no others."""
    before = pending(troubled)
    output = invoke("retry", troubled)
    assert "2 cells are pending again" in output
    assert pending(troubled) - before == {CellKey(9, 0.0), CellKey(9, 0.66)}


def test_a_status_and_a_cell_can_be_chosen(troubled: Path, invoke: Callable[..., str]) -> None:
    """Only the quarantined cell of the seed and content given becomes pending, and its lost worker is forgiven."""
    output = invoke("retry", troubled, "--status", "quarantined", "--seed", 9, "--content", 2.55)
    assert "seed 9, 2.55 %" in output
    assert len(pending(troubled)) == PENDING_BEFORE + 1
    with open_store(troubled, read_only=True) as store:
        store.use_campaign()
        count = store.attempt_counts([CellKey(9, 2.55)])[CellKey(9, 2.55)]
    assert (count.attempts, count.losses) == (2, 0)


def test_nothing_to_retry_is_said(complete: Path, invoke: Callable[..., str]) -> None:
    """A complete campaign stays as it is, with exit code 0 and a sentence."""
    assert "Nothing to retry" in invoke("retry", complete)
    assert pending(complete) == set()


@pytest.mark.parametrize("status", ["done", "pending", "nonsense"])
def test_what_cannot_be_retried_is_refused(troubled: Path, invoke: Callable[..., str], status: str) -> None:
    """Exit code 2 for a status that is no outcome gone wrong, and the database stays as it is."""
    before = pending(troubled)
    invoke("retry", troubled, "--status", status, exit_code=2)
    assert pending(troubled) == before


def test_a_cell_that_is_not_planned_is_refused(troubled: Path) -> None:
    """A seed that does not occur is an error with advice, not silence."""
    with pytest.raises(UnknownCellError, match="calcidem status"):
        retry_cells(str(troubled), selection=Selection(seeds=(99,)))


def test_a_missing_database_is_not_made(tmp_path: Path) -> None:
    """A file name with a typing error makes no empty database."""
    with pytest.raises(StoreUnavailableError, match="does not exist"):
        retry_cells(str(tmp_path / "no.db"))
    assert list(tmp_path.iterdir()) == []


def test_a_running_campaign_is_left_alone(troubled: Path) -> None:
    """While a run writes the campaign a retry is refused, since the run would not notice."""
    before = pending(troubled)
    with open_store(troubled) as master:
        master.use_campaign()
        master.acquire_lease()
        with pytest.raises(LeaseHeldError):
            retry_cells(str(troubled), [CellStatus.FAILED])
    assert pending(troubled) == before
