"""The example scripts for Slurm: a job returns to the queue as often as it may, a job of an array computes its part.

Programs that do nothing stand in for calcidem and Slurm; test_slurm.py has the real ones.
"""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / "examples" / "slurm.sbatch"
ARRAY_SCRIPT = SCRIPT.with_name("slurm-array.sbatch")

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
    """It runs the other script from the folder of submission, with the number of parts of the array or that given."""
    (tmp_path / "examples").mkdir()
    shutil.copy(SCRIPT, tmp_path / "examples")
    (tmp_path / "calcidem").write_text('#!/bin/sh\necho "$@" > asked\n')
    (tmp_path / "calcidem").chmod(0o755)
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "SLURM_ARRAY_TASK_ID": "3"} | variables
    command = [BASH, ARRAY_SCRIPT, "paper.toml", "--packing-only"]
    ended = subprocess.run(command, check=False, cwd=tmp_path, env=environment)
    assert ended.returncode == 0
    asked = f"run paper.toml --ranks 0 --part {part} --db part-3.db --packing-only"
    assert (tmp_path / "asked").read_text().split() == asked.split()


def test_a_job_outside_an_array_is_refused_with_the_cure(tmp_path: Path) -> None:
    """Without the number of an array's job nothing is computed, and the message says what to submit."""
    environment = {"PATH": os.environ["PATH"]}
    command = [BASH, ARRAY_SCRIPT, "paper.toml"]
    ended = subprocess.run(command, check=False, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ended.returncode != 0
    assert "give --array=1-8" in ended.stderr
