"""The wheel has what calcidem needs besides Python modules."""

import subprocess
import zipfile
from pathlib import Path

import pytest

import calcidem

ROOT = Path(__file__).parents[2]


def test_wheel_contains_data(tmp_path: Path) -> None:
    """Every file of the package is in the wheel: campaign, packings, pages and styles, not only modules."""
    builder = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is not installed")
    (wheel,) = builder.WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    assert Path(wheel).name.startswith(f"calcidem-{calcidem.__version__}-")
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if name.startswith("calcidem/")}
    tracked = subprocess.run(["git", "ls-files", "calcidem"], cwd=ROOT, capture_output=True, text=True, check=True)  # noqa: S607 - whichever git there is
    assert {"calcidem/app/config/presets/paper.nc", "calcidem/py.typed"} <= set(tracked.stdout.splitlines()) <= names
