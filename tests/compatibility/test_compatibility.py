"""What version 1.0 promised is there, and what it wrote can be read."""

import json
import sys
from pathlib import Path

import pytest
import xarray as xr
from typer.testing import CliRunner
from unchanged import digests

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.cli.main import _build_application
from calcidem.storage.netcdf import import_netcdf
from calcidem.storage.sql.store import Store

sys.path.insert(0, str(Path(__file__).parent))
from kept import ASSETS, contents_of, expected, open_kept
from promise import FILE, lost_names, promised

MOST_BYTES = 100_000


def test_the_program_has_the_names_that_are_promised() -> None:
    """Names of Python, commands, exit codes, configuration, database and NetCDF are those of the kept file."""
    kept = json.loads(FILE.read_text(encoding="utf-8"))["names"]
    now = promised()
    assert lost_names(kept, now) == [], "see docs/store.md before a name goes away"
    assert now == kept, "new names: run python tests/compatibility/promise.py"


def test_a_lost_name_is_found() -> None:
    """An option, a whole command, and a command without options are missed when they go away; new ones are not."""
    before = {"commands": {"run": ["--ranks", "--db"], "former": []}}
    now = {"commands": {"run": ["--db", "--new"], "later": []}}
    assert lost_names(before, now) == ["commands: run --ranks", "commands: former"]
    assert lost_names(now, now) == []


def test_a_database_of_version_1_is_read_and_written_on(tmp_path: Path) -> None:
    """Identity, outcomes, velocities and arrays are found; reading changes no byte; it can be opened for writing."""
    database = open_kept("db", tmp_path)
    before = digests([tmp_path])
    with open_campaign(database) as campaign:
        assert contents_of(campaign) == expected()
        assert campaign.store.damage() == []
        assert campaign.vs().notnull().sum() == sum(cell[2] == "done" for cell in expected()["cells"])
    shown = CliRunner().invoke(_build_application(), ["query", str(database), "--status", "done"])
    assert shown.exit_code == 0, shown.output
    assert digests([tmp_path]) == before
    with Store(database) as store:
        store.use_campaign()
        assert store.damage() == []


def test_a_netcdf_file_of_version_1_is_read(tmp_path: Path) -> None:
    """Xarray alone finds the velocities, and `import` makes a database with the same contents."""
    file = open_kept("nc", tmp_path)
    with xr.open_dataset(file) as dataset:
        found = float(dataset.vs.sel(seed=1, content=5.0))
    assert found == pytest.approx(next(cell[3] for cell in expected()["cells"] if cell[0] == 1), abs=0.0)
    database = tmp_path / "imported.db"
    with Store(database) as store:
        import_netcdf(file, store)
    with open_campaign(database) as campaign:
        assert contents_of(campaign) == expected()


def test_the_kept_files_are_small() -> None:
    """They take less than 100 kB together."""
    assert sum(path.stat().st_size for path in ASSETS.iterdir()) < MOST_BYTES
