"""Shared by the tests of robustness: small stored campaigns, and the commands as users type them."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from places import TUTORIAL
from workbench import Workbench, open_workbench

from calcidem.app.config.presets import preset_text
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.schema import Configuration
from calcidem.ends import CellStatus
from calcidem.storage.records import CellKey, CellResult
from calcidem.storage.sql.store import Store

TROUBLES = {
    CellKey(9, 0.0): CellStatus.FAILED,
    CellKey(9, 0.66): CellStatus.TIMED_OUT,
    CellKey(9, 2.55): CellStatus.QUARANTINED,
    CellKey(10, 5.0): CellStatus.NO_ARRIVAL,
}
"""Cells that went wrong in the troubled database; the six others of its seeds 9 and 10 are pending."""


@pytest.fixture
def complete(tmp_path: Path) -> Path:
    """Give a copy of the tutorial's database in the present schema."""
    path = Path(shutil.copy(TUTORIAL, tmp_path / "complete.db"))
    Store(path).close()
    return path


@pytest.fixture
def as_configured(tmp_path: Path) -> Callable[[Path], Configuration]:
    """Give a function that gives the configuration of such a campaign, with ten seeds, and writes it to `c.toml`."""

    def configure(database: Path) -> Configuration:
        text = preset_text("quick").replace("seeds = 4", "seeds = 10")
        (tmp_path / "c.toml").write_text(text, encoding="utf-8")
        return load_configuration(tmp_path / "c.toml", {"database": str(database)})

    return configure


@pytest.fixture
def troubled(complete: Path, tmp_path: Path) -> Path:
    """Give a database with 8 complete seeds and two more in which cells went wrong."""
    path = Path(shutil.copy(complete, tmp_path / "troubled.db"))
    with Store(path) as store:
        record = store.use_campaign()
        store.extend((9, 10), record.contents)
        _, run = store.runs()[0]
        store.record_running([CellKey(9, 2.55)])
        store.begin_run(replace(run, started=run.started + timedelta(days=1)))  # which counts it as lost
        store.record_results(
            CellResult(key, status, f"what went wrong is {status}", attempt=2 if key == CellKey(9, 2.55) else 1)
            for key, status in TROUBLES.items()
        )
        store.end_run("complete", run.started + timedelta(days=1))
    return path


@pytest.fixture
def part(complete: Path, tmp_path: Path) -> Callable[..., Path]:
    """Give a function that makes a database with some seeds of the complete one."""

    def make(name: str, seeds: set[int], **changes: float | None) -> Path:
        path = tmp_path / name
        with Store(complete, read_only=True) as whole, Store(path) as store:
            record = whole.use_campaign()
            store.begin_campaign(replace(record, seeds=tuple(seeds)))
            _, run = whole.runs()[0]
            store.begin_run(run)
            packing = whole.packing()
            assert packing is not None
            store.save_packing(packing)
            results = whole.results(with_arrays=True)
            store.record_results(replace(result, **changes) for result in results if result.key.seed in seeds)
        return path

    return make


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workbench]:
    """Give a folder with good and bad files, and commands that compute nothing."""
    with open_workbench(tmp_path_factory.mktemp("bench")) as opened:
        yield opened
