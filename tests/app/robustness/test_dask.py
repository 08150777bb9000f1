"""`calcidem run --dask` with a real cluster of processes on this machine: whatever happens to it costs only time."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from places import CHECKOUT

from calcidem.app.campaign.opened import open_campaign

if TYPE_CHECKING:
    from conftest import Cells, Workshop

pytest.importorskip("distributed")

PATIENCE = 120.0
FULL = pytest.mark.full


class Cluster:
    """A scheduler and its workers."""

    def __init__(self, workshop: "Workshop") -> None:
        self._workshop = workshop
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self._port}"
        self.start_scheduler()
        self.workers: list[subprocess.Popen[bytes]] = []

    def start_scheduler(self) -> None:
        """Start a scheduler at the address and wait until it listens."""
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", str(self._port), "--no-dashboard")
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            try:
                return socket.create_connection(("127.0.0.1", self._port)).close()
            except OSError:
                time.sleep(0.1)
        pytest.fail("the scheduler did not start")

    def start_worker(self) -> None:
        """Start a worker with one thread; it joins by itself."""
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "30")
        self.workers.append(self._start("worker", self.address, *options))

    def _start(self, what: str, *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments],
            cwd=self._workshop.folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ
            | {
                "PYTHONPATH": str(CHECKOUT),
                "WORKSHOP": str(self._workshop.folder),
                "OMP_NUM_THREADS": "1",
                "DASK_DISTRIBUTED__WORKER__DAEMON": "false",
            },
        )


@pytest.fixture
def cluster(workshop: "Workshop") -> Iterator[Cluster]:
    """Give a cluster of one worker; the workshop kills what is left of it."""
    workshop.configure()
    found = Cluster(workshop)
    found.start_worker()
    yield found
    for process in (*found.workers, found.scheduler):
        process.kill()
        process.wait()


def ranks_used(workshop: "Workshop") -> set[int | None]:
    """Numbers of the workers that have computed something; samples without cement have the outcome of the first."""
    with open_campaign(workshop.database) as campaign:
        return {cell.rank for cell in campaign.select() if cell.seconds is not None}


@pytest.mark.full
def test_a_cluster_gives_the_same_bits(workshop: "Workshop", expected: "Cells", cluster: Cluster) -> None:
    """Every outcome equals that of one process, signals and cement included."""
    done = workshop.run("run", "c.toml", "--dask", cluster.address)
    assert done.code == 0, done.errors
    assert workshop.cells() == expected


@FULL
@pytest.mark.parametrize("event", ["joins", "is killed", "retires"])
def test_workers_may_come_and_go(workshop: "Workshop", expected: "Cells", cluster: Cluster, event: str) -> None:
    """A worker that joins in mid-run is used, one that is killed or retires costs nothing but time."""
    if event != "joins":
        cluster.start_worker()
    process = workshop.start("run", "c.toml", "--dask", cluster.address)
    workshop.wait_for_cells(1)
    if event == "joins":
        cluster.workers[0].send_signal(signal.SIGSTOP)  # what comes now is by the other one, however slow its start
        cluster.start_worker()
        workshop.wait_for_cells(5)
        cluster.workers[0].send_signal(signal.SIGCONT)
    else:
        cluster.workers[0].send_signal(signal.SIGKILL if event == "is killed" else signal.SIGTERM)
    done = workshop.wait(process)
    assert done.code == 0, done.errors
    assert workshop.cells() == expected
    if event == "joins":
        assert ranks_used(workshop) == {1, 2}


@FULL
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_after_the_death_of_the_scheduler_the_same_command_goes_on(
    workshop: "Workshop", expected: "Cells", cluster: Cluster, number: signal.Signals
) -> None:
    """The run ends with 75 and a sentence; with a new scheduler at the address the same command computes the rest."""
    process = workshop.start("run", "c.toml", "--dask", cluster.address)
    workshop.wait_for_cells(1)
    cluster.scheduler.send_signal(number)
    ended = workshop.wait(process)
    assert ended.code == 75, ended.errors
    assert "the same command or call continues" in ended.output
    assert workshop.attempts() < len(expected)
    cluster.scheduler.wait()
    cluster.workers[0].kill()
    cluster.start_scheduler()
    cluster.start_worker()
    done = workshop.run("run", "c.toml", "--dask", cluster.address)
    assert done.code == 0, done.errors
    assert workshop.cells() == expected
    assert workshop.attempts() == len(expected)


@FULL
@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGTERM])
def test_a_signal_ends_the_command_and_the_same_one_goes_on(
    workshop: "Workshop", expected: "Cells", cluster: Cluster, number: signal.Signals
) -> None:
    """SIGUSR1 waits for what is under way, SIGTERM does not; both end with 75, and nothing is computed wrongly."""
    process = workshop.start("run", "c.toml", "--dask", cluster.address)
    workshop.wait_for_cells(1)
    process.send_signal(number)
    ended = workshop.wait(process)
    assert ended.code in {0, 75}, ended.errors  # with SIGUSR1 all may have been under way
    done = workshop.run("run", "c.toml", "--dask", cluster.address)
    assert done.code == 0, done.errors
    assert workshop.cells() == expected


@FULL
def test_no_scheduler_is_bad_input(workshop: "Workshop") -> None:
    """The command ends with 2 and what to give, before it makes a database."""
    workshop.configure()
    refused = workshop.run("run", "c.toml", "--dask", "tcp://127.0.0.1:9")
    assert refused.code == 2
    assert "no scheduler answers there" in refused.errors
    assert not workshop.database.exists()
