"""Campaigns over several hosts: network, process, mount and name spaces on this machine, with an sshd in each."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from calcidem.app.campaign.opened import open_campaign

sys.path.insert(0, str(Path(__file__).with_name("programs")))

from fault_matrix import CHECKOUT, Cells, RunEnd, Trial, reference
from slurm_cluster import NO_SLURM, Cluster, can_start_slurm

HOSTS = Path(__file__).with_name("programs") / "hosts.sh"
PROGRAMS = ("ip", "unshare", "nsenter", "ssh", "ssh-keygen", "sshd", "pgrep")
SEEDS = 20
PATIENCE = 500.0
LIMIT = 15.0
"""Time limit of a batch, s, that a busy machine does not reach either."""


def can_make_hosts() -> bool:
    """Whether this machine lets hosts be made."""
    path = f"{os.environ['PATH']}:/usr/sbin:/sbin"
    if os.geteuid() != 0 or any(shutil.which(program, path=path) is None for program in PROGRAMS):
        return False
    command = ["unshare", "--net", "--mount", "--pid", "--fork", "true"]
    return subprocess.run(command, check=False, capture_output=True).returncode == 0


pytestmark = [
    pytest.mark.mpi,
    pytest.mark.full,
    pytest.mark.skipif(
        not can_make_hosts(), reason="no hosts: needs root, namespaces, iproute2, util-linux, procps and openssh-server"
    ),
]


class HostTrial(Trial):
    """A campaign whose command runs on one of three hosts, by default nodeA, with ranks on all of them."""

    command_host = "nodeA"
    ranks_on = "nodeA slots=2\nnodeB slots=1\nnodeC slots=1\n"

    @property
    def variables(self) -> dict[str, str]:
        """Variables of the environment that any launch needs."""
        return {
            "PYTHONPATH": str(CHECKOUT),
            "CALCIDEM_CACHE": str(self.folder / "cache"),
            "OMPI_MCA_btl": "^ofi",
            "FAULT_FOLDER": str(self.folder),
        }

    def on(self, host: str) -> list[str]:
        """Beginning of a command line that is to run on a host."""
        return [str(HOSTS), str(self.folder), "in", host]

    def begin(self, *options: str) -> subprocess.Popen[str]:
        """Start the command."""
        (self.folder / "hostfile").write_text(self.ranks_on)
        own = {
            "PRTE_MCA_plm_ssh_args": f"-F {self.folder}/.hosts/ssh_config",
            "PRTE_MCA_prte_default_hostfile": f"{self.folder}/hostfile",
        }
        command = [*self.on(self.command_host), sys.executable, "-m", "calcidem", "run", "c.toml", *options]
        environment = os.environ | self.variables | own
        with (self.folder / "output").open("w") as output:
            return subprocess.Popen(
                [*command, "--ranks", "4"], env=environment, stdout=output, stderr=output, text=True
            )

    def do(self, *words: str) -> None:
        """Do something with the hosts."""
        subprocess.run([str(HOSTS), str(self.folder), *words], check=True, capture_output=True)

    def wait_for(self, text: str) -> None:
        """Wait until the command has written this."""
        end = time.monotonic() + PATIENCE
        while text not in (self.folder / "output").read_text():
            assert time.monotonic() < end, (self.folder / "output").read_text()
            time.sleep(0.2)

    def finish(self, process: subprocess.Popen[str]) -> RunEnd:
        """Wait for the end."""
        return self.wait(process, PATIENCE)


@pytest.fixture(scope="module")
def host_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder for the packing."""
    return tmp_path_factory.mktemp("host-cache")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, host_cache: Path) -> Cells:
    """Give what one host computes; puts the packing into the cache."""
    return reference(tmp_path_factory.mktemp("undisturbed"), host_cache, SEEDS)


@pytest.fixture
def trial(undisturbed: Cells, host_cache: Path) -> Iterator[HostTrial]:
    """Give a campaign and three hosts; not below /tmp, of which each host has its own."""
    assert undisturbed
    folder = Path("/var/lib") / f"calcidem-hosts-{os.getpid()}"
    shutil.copytree(host_cache, folder / "cache")
    trial = HostTrial(folder, folder / "cache", SEEDS)
    try:
        trial.do("up", "3")
        yield trial
    finally:
        trial.kill_all()
        trial.do("down")
        shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.parametrize("command_host", ["nodeA", "nodeC"])
def test_a_campaign_completes_over_hosts(trial: HostTrial, undisturbed: Cells, command_host: str) -> None:
    """The bits are those of one host and the exit code is 0, also from a login node, which has no rank."""
    trial.command_host = command_host
    trial.ranks_on = "nodeA slots=3\nnodeB slots=1\n"
    ended = trial.finish(trial.begin())
    assert ended.code == 0, ended.output
    assert trial.cells() == undisturbed


def test_hosts_need_no_shared_folder(trial: HostTrial, undisturbed: Cells) -> None:
    """What workers on other hosts need comes from rank 0: neither configuration nor packing have to be there."""
    for host in ("nodeB", "nodeC"):
        trial.do("part", host)
    ended = trial.finish(trial.begin())
    assert ended.code == 0, ended.output
    assert trial.cells() == undisturbed


def test_dask_workers_on_other_hosts_compute(trial: HostTrial, undisturbed: Cells) -> None:
    """Scheduler and command on one host, a worker on each of the others: the bits are those of one host."""
    pytest.importorskip("distributed")
    address, environment = "tcp://nodeA:8786", os.environ | trial.variables | {"OMP_NUM_THREADS": "1"}
    worker = ("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60")
    programs = [("nodeA", ("scheduler", "--host", "nodeA", "--port", "8786", "--no-dashboard"))]
    programs += [(host, worker) for host in ("nodeB", "nodeC")]
    running = [
        subprocess.Popen(
            [*trial.on(host), sys.executable, "-m", f"distributed.cli.dask_{name}", *options],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for host, (name, *options) in programs
    ]
    command = [*trial.on("nodeA"), sys.executable, "-m", "calcidem", "run", "c.toml", "--dask", address]
    with (trial.folder / "output").open("w") as output:
        process = subprocess.Popen(command, env=environment, stdout=output, stderr=output, text=True)
    try:
        ended = trial.finish(process)
    finally:
        for program in running:
            program.kill()
            program.wait()
    assert ended.code == 0, ended.output
    assert trial.cells() == undisturbed


@pytest.mark.parametrize("event", ["dies", "loses its link"])
def test_a_campaign_goes_on_without_a_lost_host(trial: HostTrial, undisturbed: Cells, event: str) -> None:
    """No start succeeds while the host is named, so the command ends with 75; without it the same command completes."""
    trial.configure(LIMIT)
    process = trial.begin("--restarts", "1", "--start-timeout", "60")
    trial.wait_for(" cells in ")
    trial.do(*(("kill", "nodeB") if event == "dies" else ("link", "nodeB", "down")))
    ended = trial.finish(process)
    assert ended.code == 75, ended.output
    assert "Start 2 of at most 2" in ended.output
    trial.ranks_on = "nodeA slots=2\nnodeC slots=2\n"
    ended = trial.finish(trial.begin())
    assert ended.code == 0, ended.output
    assert trial.cells() == undisturbed


def test_a_run_whose_host_dies_goes_on_elsewhere(trial: HostTrial, undisturbed: Cells) -> None:
    """Where command and rank 0 die with their host, another one waits until their lease is over, and completes."""
    process = trial.begin()
    trial.wait_for(" cells in ")
    trial.do("kill", "nodeA")
    process.wait(10.0)
    trial.command_host, trial.ranks_on = "nodeB", "nodeB slots=2\nnodeC slots=2\n"
    ended = trial.finish(trial.begin())
    assert ended.code == 0, ended.output
    assert "on nodeA was writing this campaign" in ended.output
    assert "Taken over from" in ended.output
    assert trial.cells() == undisturbed
    attempts = trial.attempts()
    assert attempts.total() - attempts["lost"] == len(undisturbed)


@pytest.mark.parametrize("trouble", ["unknown", "down", "no launcher"])
def test_a_host_that_cannot_start_is_no_reason_to_requeue(trial: HostTrial, trouble: str) -> None:
    """A host that is unknown, down or without Open MPI ends the run with 1, not 75; nothing is said to be stored."""
    match trouble:
        case "unknown":
            trial.ranks_on = "nodeA slots=3\nnodeX slots=1\n"
        case "down":
            trial.do("kill", "nodeB")
        case "no launcher":
            trial.do("in", "nodeB", "mount", "-t", "tmpfs", "tmpfs", str(Path(sys.executable).parent))
    ended = trial.finish(trial.begin())
    assert ended.code == 1, ended.output
    assert "The run did not begin" in ended.output
    assert "everything stored is safe" not in ended.output
    assert not trial.settled()


@pytest.mark.skipif(not can_start_slurm(), reason=NO_SLURM)
def test_the_example_for_slurm_uses_all_nodes(trial: HostTrial, undisturbed: Cells) -> None:
    """A job of `init --slurm` with three tasks on three nodes computes on all of them, with the bits of one."""
    (trial.folder / "slurm").mkdir()
    hosts = {host: trial.on(host) for host in ("nodeA", "nodeB", "nodeC")}
    cluster = Cluster(trial.folder / "slurm", hosts, "/tmp/munge.socket")  # noqa: S108 - each host has its own
    cluster.variables |= trial.variables | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    try:
        cluster.start()
        options = ("--nodes=3", "--ntasks=3", f"--output={trial.folder}/output", f"--chdir={trial.folder}")
        job = cluster.submit(*options, str(CHECKOUT / "calcidem/app/config/presets/slurm.sbatch"), "c.toml")
        state = cluster.wait_for_end(job, PATIENCE)
    finally:
        cluster.stop()
    assert (state["JobState"], state["ExitCode"]) == ("COMPLETED", "0:0"), (trial.folder / "output").read_text()
    assert trial.cells() == undisturbed
    with open_campaign(trial.database) as campaign:
        assert {cell.host for cell in campaign.select()} == {"nodeA", "nodeB", "nodeC"}
