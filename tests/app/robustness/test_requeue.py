"""The Slurm job that `init --slurm` writes: it is requeued as often as it may, and an array computes its parts.

Programs that do nothing stand in for calcidem and Slurm; test_slurm.py has the real ones.
"""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from places import CHECKOUT
from typer.testing import CliRunner

from calcidem.app.cli.main import _build_application

SCRIPT = CHECKOUT / "calcidem" / "app" / "config" / "presets" / "slurm.sbatch"

BASH = shutil.which("bash") or ""

pytestmark = pytest.mark.skipif(not BASH, reason="a script for bash")


@pytest.mark.parametrize(
    ("code", "restarts", "variables", "requeued"),
    [
        (75, None, {}, True),
        (75, 19, {}, True),
        (75, 20, {}, False),
        (75, 2, {"CALCIDEM_REQUEUES": "2"}, False),
        (1, None, {}, False),
        (0, None, {}, False),
    ],
)
def test_a_job_is_requeued_a_limited_number_of_times_and_only_if_it_can_go_on(
    code: int, restarts: int | None, variables: dict[str, str], requeued: bool, tmp_path: Path
) -> None:
    """Exit code 75 means that the same command continues; the script ends with the run's code in any case."""
    for name, line in {"calcidem": f"exit {code}", "scontrol": 'echo "$@" > asked', "sleep": "exit 0"}.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{line}\n")
        (tmp_path / name).chmod(0o755)
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "SLURM_JOB_ID": "7"} | variables
    environment |= {} if restarts is None else {"SLURM_RESTART_COUNT": str(restarts)}
    ended = subprocess.run([BASH, SCRIPT, "paper.toml"], check=False, cwd=tmp_path, env=environment)
    assert ended.returncode == code
    assert (tmp_path / "asked").exists() == requeued


@pytest.mark.parametrize(
    ("variables", "part"),
    [({"SLURM_ARRAY_TASK_COUNT": "8"}, "3/8"), ({"SLURM_ARRAY_TASK_COUNT": "2", "PARTS": "8"}, "3/8")],
)
def test_a_job_of_an_array_computes_its_part_into_its_own_database(
    variables: dict[str, str], part: str, tmp_path: Path
) -> None:
    """It has the number of parts of the array or that given."""
    (tmp_path / "calcidem").write_text('#!/bin/sh\necho "$@" > asked\n')
    (tmp_path / "calcidem").chmod(0o755)
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "SLURM_ARRAY_TASK_ID": "3"} | variables
    command = [BASH, SCRIPT, "paper.toml", "--packing-only"]
    ended = subprocess.run(command, check=False, cwd=tmp_path, env=environment)
    assert ended.returncode == 0
    asked = f"run paper.toml --ranks 0 --part {part} --db part-3.db --packing-only"
    assert (tmp_path / "asked").read_text().split() == asked.split()


def test_the_job_of_a_configuration_is_written_beside_it(tmp_path: Path) -> None:
    """`init --slurm` writes both, keeps a configuration that exists, and no job; the job knows its configuration."""
    for configuration in ("my sand.toml", "kept.toml"):
        file = tmp_path / configuration
        (tmp_path / "kept.toml").write_text("kept")
        done = CliRunner().invoke(_build_application(), ["init", str(file), "--slurm"])
        assert done.exit_code == 0, done.output
        assert f"then, in its folder: sbatch {file.stem}.sbatch\n" in done.output
        assert (file.read_text() == "kept") == (configuration == "kept.toml")
        assert CliRunner().invoke(_build_application(), ["init", str(file), "--slurm"]).exit_code == 2
        (tmp_path / "calcidem").write_text('#!/bin/sh\nprintf "%s\\n" "$@" > asked\n')
        (tmp_path / "calcidem").chmod(0o755)
        environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
        subprocess.run([BASH, file.with_suffix(".sbatch")], check=True, cwd=tmp_path, env=environment)
        assert (tmp_path / "asked").read_text().splitlines() == ["run", configuration, "--ranks", "0"]
