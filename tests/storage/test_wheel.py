"""The wheel has what a store needs besides Python modules."""

import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_wheel_contains_data(tmp_path: Path) -> None:
    """The shipped campaign and the packings of the examples are in the wheel."""
    builder = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is not installed")
    (wheel,) = builder.WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert "calcidem/app/config/presets/paper.nc" in names, "the campaign that load_paper_campaign reads"
    packings = {name for name in names if name.startswith("calcidem/app/config/presets/packings/")}
    in_tree = (ROOT / "calcidem" / "app" / "config" / "presets" / "packings").glob("*.npz")
    assert packings == {str(path.relative_to(ROOT)) for path in in_tree} != set(), "the packings of the examples"
