"""`calcidem run --retry`: cells that went wrong become pending again, and nothing else does."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from calcidem.app.campaign.launch import Launch
from calcidem.app.campaign.run import retry_cells
from calcidem.app.config.schema import Configuration
from calcidem.ends import CellStatus
from calcidem.storage.errors import LeaseHeldError, StoreUnavailableError
from calcidem.storage.records import CellKey
from calcidem.storage.sql.store import Store

PENDING_BEFORE = 6

RETRIABLE = (CellStatus.FAILED, CellStatus.TIMED_OUT, CellStatus.QUARANTINED)
"""Outcomes that another attempt may change."""

AsConfigured = Callable[[Path], Configuration]


def pending(database: Path) -> set[CellKey]:
    """Pending cells of a database."""
    with Store(database, read_only=True) as store:
        store.use_campaign()
        return set(store.pending())


def test_the_command_names_what_it_computes_again(
    troubled: Path, as_configured: AsConfigured, invoke: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cells with the outcomes given become pending, no others, before anything is computed; without any it is said."""
    as_configured(troubled)
    monkeypatch.setattr("calcidem.app.campaign.run.run_command_line", lambda load, *_: load() and 0)  # computes nothing
    before = pending(troubled)
    command = ("run", troubled.with_name("c.toml"), "--db", troubled, "--retry", "failed", "--retry", "timed_out")
    assert "2 cells to compute again:\n  seed 9, 0 %\n  seed 9, 0.66 %\n" in invoke(*command)
    assert pending(troubled) - before == {CellKey(9, 0.0), CellKey(9, 0.66)}
    assert "There is nothing to retry." in invoke(*command)


def test_ranks_are_not_told_to_retry(
    troubled: Path, as_configured: AsConfigured, invoke: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command itself makes cells pending: ranks that are started again would do so with cells of the last start."""
    as_configured(troubled)
    told: list[list[str]] = []

    def note(launch: Launch, load: Callable[[], object], _view: object) -> int:
        load()
        told.append(list(launch.arguments))
        return 0

    monkeypatch.setattr(Launch, "run", note)
    invoke("run", troubled.with_name("c.toml"), "--db", troubled, "--retry", "failed", "--ranks", 3)
    assert told == [["run", str(troubled.with_name("c.toml")), "--db", str(troubled)]]
    assert len(pending(troubled)) == PENDING_BEFORE + 1


def test_a_lost_worker_is_forgiven(troubled: Path, as_configured: AsConfigured) -> None:
    """A quarantined cell becomes pending with its history, and without the workers that were lost to it."""
    assert retry_cells(as_configured(troubled), [CellStatus.QUARANTINED]) == (CellKey(9, 2.55),)
    with Store(troubled, read_only=True) as store:
        store.use_campaign()
        count = store.attempt_counts([CellKey(9, 2.55)])[CellKey(9, 2.55)]
    assert (count.attempts, count.losses) == (2, 0)


def test_only_cells_of_the_configuration_are_retried(troubled: Path, as_configured: AsConfigured) -> None:
    """What the configuration does not plan stays as it is."""
    whole = as_configured(troubled)
    part = replace(whole, campaign=replace(whole.campaign, seeds=(1, 9), contents=(0.66, 5.0)))
    assert retry_cells(part, RETRIABLE) == (CellKey(9, 0.66),)


@pytest.mark.parametrize("outcome", ["done", "pending", "no_arrival", "nonsense"])
def test_what_cannot_be_retried_is_refused(
    troubled: Path, as_configured: AsConfigured, invoke: Callable[..., str], outcome: str
) -> None:
    """Exit code 2 for what another attempt would not change, and the database stays as it is."""
    as_configured(troubled)
    before = pending(troubled)
    invoke("run", troubled.with_name("c.toml"), "--db", troubled, "--retry", outcome, exit_code=2)
    assert pending(troubled) == before


def test_a_missing_database_is_not_made(tmp_path: Path, as_configured: AsConfigured) -> None:
    """A file name with a typing error makes no empty database."""
    with pytest.raises(StoreUnavailableError, match="does not exist"):
        retry_cells(as_configured(tmp_path / "no.db"), RETRIABLE)
    assert {path.name for path in tmp_path.iterdir()} == {"c.toml"}


def test_a_running_campaign_is_left_alone(troubled: Path, as_configured: AsConfigured) -> None:
    """While a run writes the campaign a retry is refused, since the run would not notice."""
    before = pending(troubled)
    with Store(troubled) as master:
        master.use_campaign()
        master.acquire_lease()
        with pytest.raises(LeaseHeldError):
            retry_cells(as_configured(troubled), [CellStatus.FAILED])
    assert pending(troubled) == before
