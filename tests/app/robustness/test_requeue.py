"""The example script for Slurm puts itself back into the queue as often as it may, and only if the run can go on.

Programs that do nothing stand in for calcidem and Slurm; test_slurm.py has the real ones.
"""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / "examples" / "slurm.sbatch"

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
