"""The example files for GNU parallel, Snakemake and HyperQueue compute a campaign in parts, with the real tools."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from places import CHECKOUT

if TYPE_CHECKING:
    from conftest import Cells, Workshop

EXAMPLES = CHECKOUT / "examples"
OUT = "results/small.db"
COMMANDS = {
    "parallel": ["bash", str(EXAMPLES / "gnu-parallel.sh"), "c.toml", OUT, "2"],
    "snakemake": [
        *("snakemake", "-s", str(EXAMPLES / "Snakefile"), "--cores", "2"),
        *("--config", "campaign=c.toml", "parts=2", f"out={OUT}"),
    ],
    "hyperqueue": [sys.executable, str(EXAMPLES / "hyperqueue_parts.py"), "c.toml", OUT, "2"],
}
PATIENCE = 600.0


def run_engine(engine: str, folder: Path, programs: Path, variables: Mapping[str, str]) -> None:
    """Run an example in a folder, with the command `calcidem` of a folder of programs; skip what is not installed."""
    if shutil.which(engine) is None and find_spec(engine) is None:
        pytest.skip(f"{engine} is not installed")
    environment = os.environ | {"PATH": f"{programs}:{os.environ['PATH']}"} | variables
    done = subprocess.run(
        COMMANDS[engine], cwd=folder, env=environment, timeout=PATIENCE, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    "engine", ["parallel", pytest.param("snakemake", marks=pytest.mark.full), pytest.param("hyperqueue")]
)
def test_an_example_computes_each_part_once_and_merges_them(engine: str, tmp_path: Path) -> None:
    """The packing is made first, the parts are all there are, and the merge comes last; a stand-in notes the calls."""
    program = tmp_path / "calcidem"
    program.write_text(f'#!/bin/sh\necho "$@" >> {tmp_path}/asked\n')
    program.chmod(0o755)
    run_engine(engine, tmp_path, tmp_path, {})
    first, *parts, last = (tmp_path / "asked").read_text().splitlines()
    assert first == "run c.toml --packing-only"
    assert sorted(parts) == [f"run c.toml --part {part}/2 --db part-{part}.db" for part in (1, 2)]
    assert last == f"merge part-1.db part-2.db --out {OUT}"


@pytest.mark.full
@pytest.mark.parametrize("engine", COMMANDS)
def test_an_engine_gives_the_bits_of_one_process(engine: str, workshop: "Workshop", expected: "Cells") -> None:
    """Every outcome of the merged parts equals that of a run without parts, signals and cement included."""
    workshop.configure()
    workshop.database.parent.mkdir()
    variables = {"CALCIDEM_CACHE": str(workshop.cache), "WORKSHOP": str(workshop.folder)}
    run_engine(engine, workshop.folder, Path(sys.executable).parent, variables)
    assert workshop.cells() == expected
