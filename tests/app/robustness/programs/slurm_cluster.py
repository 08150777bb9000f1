"""A real Slurm on this machine, of one node or of hosts that `hosts.sh` has made: used by the tests."""

import os
import re
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol")

NO_SLURM = "no Slurm to start: needs root and apt-get install --no-install-recommends slurm-wlm munge"


def can_start_slurm() -> bool:
    """Whether this machine has Slurm, and lets it be started."""
    return os.geteuid() == 0 and all(shutil.which(program) for program in PROGRAMS)


CONFIGURATION_OF_SLURM = """
ClusterName=test
SlurmctldHost={host}
SlurmUser=root
SlurmctldPort={port}
SlurmdPort={next_port}
AuthType=auth/munge
CryptoType=crypto/munge
AuthInfo=socket={socket},cred_expire=5
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
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
NodeName={nodes} CPUs={cores} State=UNKNOWN
PartitionName=test Nodes={nodes} Default=YES MaxTime=INFINITE State=UP
"""


class Cluster:
    """Slurm with this machine as its only node, or with several hosts.

    Parameters
    ----------
    folder
        Empty, and seen by all hosts.
    hosts
        How a command line begins that is to run on each of them, by name; the first has the controller.
    munge_socket
        A path that is another file on every host.
    """

    def __init__(self, folder: Path, hosts: Mapping[str, Sequence[str]] | None = None, munge_socket: str = "") -> None:
        self.folder = folder
        self.variables = os.environ | {"SLURM_CONF": str(folder / "slurm.conf")}
        self._hosts = hosts or {socket.gethostname().partition(".")[0]: ()}
        self._socket = munge_socket or f"{folder}/munge.socket"
        self._daemons: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        """Start the daemons and wait until all nodes are there."""
        controller = next(iter(self._hosts))
        (self.folder / "state").mkdir()
        text = CONFIGURATION_OF_SLURM.format(
            host=controller,
            nodes=",".join(self._hosts),
            port=free_port(),
            next_port=free_port(),
            folder=self.folder,
            socket=self._socket,
            cores=len(os.sched_getaffinity(0)),
        )
        (self.folder / "slurm.conf").write_text(text)
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(1024))
        key.chmod(0o400)
        for host in self._hosts:
            (self.folder / f"spool-{host}").mkdir()
            own = [f"--{name}-file={self.folder}/munge-{host}.{name}" for name in ("pid", "log", "seed")]
            own += [f"--key-file={key}", f"--socket={self._socket}"]
            self._daemon(host, "munged", "--foreground", "--force", *own)
            self._wait_for(lambda host=host: self._on(host, "test", "-S", self._socket).returncode == 0)  # type: ignore[misc]
        self._daemon(controller, "slurmctld", "-D", "-f", str(self.folder / "slurm.conf"))
        for host in self._hosts:
            self._daemon(host, "slurmd", "-D", "-f", str(self.folder / "slurm.conf"), "-N", host)
        self._wait_for(lambda: self.ask("sinfo", "-h", "-N", "-o", "%t").split() == ["idle"] * len(self._hosts))

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
        return self._on(next(iter(self._hosts)), *command).stdout

    def submit(self, *words: str) -> str:
        """Submit a job and return its number."""
        answer = self._on(next(iter(self._hosts)), "sbatch", "--parsable", *words)
        assert answer.stdout.strip().isdigit(), answer
        return answer.stdout.strip()

    def wait_for_end(self, number: str, patience: float) -> dict[str, str]:
        """Wait until a job has ended, and return what Slurm knows of it then."""
        end = time.monotonic() + patience
        while (job := self.job(number))["JobState"] in {"PENDING", "RUNNING", "COMPLETING", "CONFIGURING"}:
            assert time.monotonic() < end, job
            time.sleep(1.0)
        return job

    def job(self, number: str) -> dict[str, str]:
        """What Slurm knows of a job."""
        return dict(re.findall(r"(\w+)=(\S*)", self.ask("scontrol", "show", "job", number)))

    def _on(self, host: str, *command: str) -> "subprocess.CompletedProcess[str]":
        """Run a program on a host."""
        words = [*self._hosts[host], *command]
        return subprocess.run(words, check=False, capture_output=True, text=True, env=self.variables, timeout=60)

    def _daemon(self, host: str, *command: str) -> None:
        words = [*self._hosts[host], *command]
        with (self.folder / f"{command[0]}-{host}.out").open("wb") as output:
            self._daemons.append(subprocess.Popen(words, env=self.variables, stdout=output, stderr=output))

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
