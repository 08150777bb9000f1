"""A real Slurm on this machine: a campaign that hits its time limit goes back into the queue and completes.

Needs Debian's packages slurm-wlm and munge, and root to start their daemons.
"""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from calcidem.storage.campaign import open_stored_campaign

sys.path.insert(0, str(Path(__file__).with_name("programs")))

from collections.abc import Callable, Iterator

from fault_matrix import CHECKOUT, CONFIGURATION, NO_LIMIT

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol")

pytestmark = [
    pytest.mark.mpi,
    pytest.mark.full,
    pytest.mark.skipif(
        os.geteuid() != 0 or any(shutil.which(program) is None for program in PROGRAMS),
        reason="no Slurm to start: needs root and apt-get install --no-install-recommends slurm-wlm munge",
    ),
]

PATIENCE = 400.0
"""Seconds for a job with one requeue; Slurm looks at time limits every half minute, and the machine may be busy."""

SEEDS = 200
"""400 cells: half a minute on one core, so that the job does not end before its signal, 0 to 30 s after its start."""

CONFIGURATION_OF_SLURM = """
ClusterName=test
SlurmctldHost={host}
SlurmUser=root
SlurmctldPort={port}
SlurmdPort={next_port}
AuthType=auth/munge
CryptoType=crypto/munge
AuthInfo=socket={folder}/munge.socket,cred_expire=5
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=2
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
NodeName={host} CPUs={cores} State=UNKNOWN
PartitionName=test Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


class Cluster:
    """Slurm with this machine as its only node."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.variables = os.environ | {"SLURM_CONF": str(folder / "slurm.conf")}
        self._daemons: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        """Start the daemons and wait until the node is there."""
        host = socket.gethostname().partition(".")[0]
        port = free_port()
        for name in ("state", "spool"):
            (self.folder / name).mkdir()
        cores = len(os.sched_getaffinity(0))
        text = CONFIGURATION_OF_SLURM.format(
            host=host, port=port, next_port=free_port(), folder=self.folder, cores=cores
        )
        (self.folder / "slurm.conf").write_text(text)
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(1024))
        key.chmod(0o400)
        options = [f"--{name}-file={self.folder}/munge.{name}" for name in ("key", "pid", "log", "seed")]
        self._daemon("munged", "--foreground", "--force", f"--socket={self.folder}/munge.socket", *options)
        self._wait_for((self.folder / "munge.socket").exists)
        self._daemon("slurmctld", "-D", "-f", str(self.folder / "slurm.conf"))
        self._daemon("slurmd", "-D", "-f", str(self.folder / "slurm.conf"), "-N", host)
        self._wait_for(lambda: "idle" in self.ask("sinfo", "-h", "-o", "%t"))

    def stop(self) -> None:
        """End jobs and daemons."""
        self.ask("scancel", "--user=root")
        end = time.monotonic() + 15.0
        while self.ask("squeue", "-h") and time.monotonic() < end:
            time.sleep(0.5)  # a job that is still being ended would outlive its daemons
        for daemon in reversed(self._daemons):
            daemon.send_signal(signal.SIGTERM)
        for daemon in self._daemons:
            try:
                daemon.wait(10)
            except subprocess.TimeoutExpired:
                daemon.kill()

    def ask(self, *command: str) -> str:
        """Answer of one of Slurm's programs."""
        return subprocess.run(
            command, check=False, capture_output=True, text=True, env=self.variables, timeout=60
        ).stdout

    def job(self, number: str) -> dict[str, str]:
        """What Slurm knows of a job."""
        return dict(re.findall(r"(\w+)=(\S*)", self.ask("scontrol", "show", "job", number)))

    def _daemon(self, *command: str) -> None:
        with (self.folder / f"{command[0]}.out").open("wb") as output:
            self._daemons.append(subprocess.Popen(command, env=self.variables, stdout=output, stderr=output))

    def _wait_for(self, happened: Callable[[], bool]) -> None:
        end = time.monotonic() + 30.0
        while not happened():
            if time.monotonic() > end:
                logs = "\n".join(f"{log}:\n{log.read_text()[-2000:]}" for log in self.folder.glob("*.out"))
                pytest.skip(f"Slurm did not start here:\n{logs}")
            time.sleep(0.2)


def free_port() -> int:
    """A port that nobody listens at."""
    with socket.socket() as listener:
        listener.bind(("", 0))
        port: int = listener.getsockname()[1]
        return port


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


def test_a_job_at_its_time_limit_is_requeued_and_completes(cluster: Cluster, tmp_path: Path) -> None:
    """The job of examples/slurm.sbatch is told of its limit, ends with 75, starts anew and computes no cell twice."""
    (tmp_path / "c.toml").write_text(CONFIGURATION.format(time_limit=NO_LIMIT, seeds=SEEDS))
    cluster.variables |= {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": str(CHECKOUT),
        "CALCIDEM_CACHE": str(tmp_path / "cache"),
        "OMPI_MCA_btl": "^ofi",
        "TMPDIR": str(tmp_path),
    }
    log = tmp_path / "job.log"
    limits = ("--ntasks=1", "--time=1", "--signal=B:USR1@30", f"--output={log}", f"--chdir={tmp_path}")
    answer = cluster.ask("sbatch", "--parsable", *limits, str(CHECKOUT / "examples" / "slurm.sbatch"), "c.toml")
    number = answer.strip()
    assert number.isdigit(), answer
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
    with open_stored_campaign(tmp_path / "results" / "small.db") as campaign:
        assert len(campaign.store.pending()) == 0
        assert sum(1 for _ in campaign.store.history()) == 2 * SEEDS
        runs = [run for _, run in campaign.runs()]
    assert len(runs) == int(job["Restarts"]) + 1
    assert {run.slurm_job_id for run in runs} == {number}
