"""A real Slurm on this machine: a campaign that hits its time limit goes back into the queue and completes.

Needs Debian's packages slurm-wlm and munge, and root to start their daemons.
"""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import calcidem
from calcidem.app.campaign.opened import open_campaign

sys.path.insert(0, str(Path(__file__).with_name("programs")))

from fault_matrix import CHECKOUT, CONFIGURATION, NO_LIMIT, Trial
from slurm_cluster import NO_SLURM, Cluster, can_start_slurm

pytestmark = [pytest.mark.mpi, pytest.mark.full, pytest.mark.skipif(not can_start_slurm(), reason=NO_SLURM)]

PATIENCE = 400.0
"""Seconds for a job with one requeue; Slurm looks at time limits every half minute, and the machine may be busy."""

COMPUTING = 60.0
"""Seconds of one core, so that the job does not end before its signal, 0 to 30 s after its start."""


@pytest.fixture
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Give a Slurm that is stopped after the test."""
    folder = Path(tmp_path_factory.mktemp("slurm"))
    folder.chmod(0o755)
    machine = Cluster(folder)
    try:
        machine.start()
        yield machine
    finally:
        machine.stop()


def seconds_of_a_cell(folder: Path) -> float:
    """Measure 40 cells on this machine."""
    configuration = folder / "first.toml"
    configuration.write_text(CONFIGURATION.format(step=Trial.STEP, time_limit=NO_LIMIT, seeds=20))
    with calcidem.run(configuration, db=folder / "first.db", output=folder, progress=False) as campaign:
        return float(campaign.to_dataframe(["seconds"])["seconds"].mean())


def test_a_job_at_its_time_limit_is_requeued_and_completes(cluster: Cluster, tmp_path: Path) -> None:
    """The job of `init --slurm` is told of its limit, ends with 75, starts anew and computes no cell twice."""
    seeds = round(COMPUTING / 2 / seconds_of_a_cell(tmp_path))
    (tmp_path / "c.toml").write_text(CONFIGURATION.format(step=Trial.STEP, time_limit=NO_LIMIT, seeds=seeds))
    cluster.variables |= {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": str(CHECKOUT),
        "CALCIDEM_CACHE": str(tmp_path / "cache"),
        "OMPI_MCA_btl": "^ofi",
        "TMPDIR": str(tmp_path),
    }
    log = tmp_path / "job.log"
    limits = ("--ntasks=1", "--time=1", "--signal=B:USR1@30", f"--output={log}", f"--chdir={tmp_path}")
    number = cluster.submit(*limits, str(CHECKOUT / "calcidem/app/config/presets/slurm.sbatch"), "c.toml")
    end = time.monotonic() + PATIENCE
    enough = False
    while (job := cluster.job(number))["JobState"] not in {"COMPLETED", "FAILED", "TIMEOUT", "CANCELLED", "NODE_FAIL"}:
        assert time.monotonic() < end, f"{job}\n{log.read_text() if log.exists() else ''}"
        if job["Restarts"] != "0" and not enough:
            cluster.ask("scontrol", "update", f"JobId={number}", "TimeLimit=20")
            enough = True  # however busy the machine is, the next start is the last
        time.sleep(1.0)
    told = log.read_text()
    assert (job["JobState"], job["ExitCode"]) == ("COMPLETED", "0:0"), told
    assert int(job["Restarts"]) >= 1, told
    assert "SIGUSR1: running batches were finished" in told
    with open_campaign(tmp_path / "results" / "small.db") as campaign:
        assert len(campaign.store.pending()) == 0
        assert sum(1 for _ in campaign.store.history()) == 2 * seeds
        runs = [run for _, run in campaign.runs()]
    assert len(runs) == int(job["Restarts"]) + 1
    assert {run.slurm_job_id for run in runs} == {number}
