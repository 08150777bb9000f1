"""The wheel has what a store needs besides Python modules."""

import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_wheel_contains_the_migrations(tmp_path: Path) -> None:
    """Every migration of the source tree, and what Alembic starts with, is in the wheel."""
    builder = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is not installed")
    (wheel,) = builder.WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    folder = ROOT / "calcidem" / "storage" / "sql" / "migrations"
    needed = {str(path.relative_to(ROOT)) for path in folder.rglob("*.py")} | {
        "calcidem/storage/sql/migrations/script.py.mako"
    }
    assert {"calcidem/storage/sql/migrations/versions/v0004_sample_times.py"} < needed <= names
    assert "calcidem/app/config/presets/paper.nc" in names, "the campaign that load_paper_campaign reads"
    packings = {name for name in names if name.startswith("calcidem/app/config/presets/packings/")}
    in_tree = (ROOT / "calcidem" / "app" / "config" / "presets" / "packings").glob("*.npz")
    assert packings == {str(path.relative_to(ROOT)) for path in in_tree} != set(), "the packings of the examples"
