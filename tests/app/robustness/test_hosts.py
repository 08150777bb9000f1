"""Campaigns over several hosts: network, process, mount and name spaces on this machine, with an sshd in each."""

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).with_name("programs")))

from fault_matrix import CHECKOUT, Cells, RunEnd, Trial, reference

HOSTS = Path(__file__).with_name("programs") / "hosts.sh"
PROGRAMS = ("ip", "unshare", "nsenter", "ssh", "ssh-keygen", "sshd", "pgrep")
SEEDS = 12
PATIENCE = 400.0


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

    def begin(self, *options: str) -> subprocess.Popen[str]:
        """Start the command."""
        (self.folder / "hostfile").write_text(self.ranks_on)
        own = {
            "PYTHONPATH": str(CHECKOUT),
            "CALCIDEM_CACHE": str(self.folder / "cache"),
            "OMPI_MCA_btl": "^ofi",
            "PRTE_MCA_plm_ssh_args": f"-F {self.folder}/.hosts/ssh_config",
            "PRTE_MCA_prte_default_hostfile": f"{self.folder}/hostfile",
            "FAULT_FOLDER": str(self.folder),
        }
        command = [str(HOSTS), str(self.folder), "in", self.command_host, sys.executable, "-m", "calcidem"]
        command += ["run", "c.toml", "--ranks", "4", *options]
        with (self.folder / "output").open("w") as output:
            return subprocess.Popen(command, env=os.environ | own, stdout=output, stderr=output, text=True)

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
    """The bits are those of one host and the exit code is 0, also where the command runs on a host without rank 0."""
    trial.command_host = command_host
    trial.ranks_on = "nodeA slots=3\nnodeB slots=1\n"
    ended = trial.finish(trial.begin())
    assert ended.code == 0, ended.output
    assert trial.cells() == undisturbed


def test_a_host_whose_link_goes_down_is_given_up(trial: HostTrial, undisturbed: Cells) -> None:
    """Without any time limit the run says which rank is lost, completes on the other hosts and ends with 0."""
    configuration = trial.folder / "c.toml"
    configuration.write_text(re.sub("time_limit = .*", "", configuration.read_text()))
    process = trial.begin("--silence-timeout", "20")
    trial.wait_for("cells (")
    trial.do("link", "nodeB", "down")
    ended = trial.finish(process)
    assert ended.code == 0, ended.output
    assert "(nodeB): has not been heard of for 20 s" in ended.output
    assert trial.cells() == undisturbed


def test_a_host_that_dies_is_left_out(trial: HostTrial, undisturbed: Cells) -> None:
    """The launcher ends the run when a host dies; the command starts it again on the hosts that are left."""
    process = trial.begin("--restarts", "1")
    trial.wait_for("cells (")
    trial.do("kill", "nodeB")
    ended = trial.finish(process)
    assert ended.code == 0, ended.output
    assert "Restart 1 of 1" in ended.output
    assert trial.cells() == undisturbed


def test_a_host_that_cannot_start_is_no_reason_to_requeue(trial: HostTrial) -> None:
    """A host file that names a host that is not there ends the run with 1, not 75, and nothing is said to be stored."""
    trial.ranks_on = "nodeA slots=3\nnodeX slots=1\n"
    ended = trial.finish(trial.begin())
    assert ended.code == 1, ended.output
    assert "The run did not begin" in ended.output
    assert "everything stored is safe" not in ended.output
    assert not trial.database.exists()
