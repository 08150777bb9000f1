import signal
import sqlite3
import time
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Campaign, Values

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.full), 4])
def test_results_do_not_depend_on_the_number_of_ranks(campaign: "Campaign", expected: "Values", ranks: int) -> None:
    """1, 2 and 4 ranks give the same values, exit code 0 and no process left."""
    launch = campaign.run("--seconds", "0.02", ranks=ranks)
    assert launch.exit_code == 0, launch.errors
    assert campaign.values() == expected
    assert launch.stored() == expected.keys()
    assert campaign.leaves_no_process()


def test_all_workers_take_part(campaign: "Campaign") -> None:
    """Batches that take a while are spread over all workers and none is computed by the master."""
    campaign.run("--seconds", "0.1", ranks=4)
    assert campaign.rows("select distinct rank from cell order by rank") == [(1,), (2,), (3,)]


def test_a_complete_sweep_ends_at_once(campaign: "Campaign", expected: "Values") -> None:
    """With nothing left to compute the program ends with 0 and stores nothing twice."""
    campaign.run()
    launch = campaign.run()
    assert (launch.exit_code, launch.stored()) == (0, set())
    assert campaign.values() == expected


def test_large_results_arrive_whole(campaign: "Campaign", expected: "Values") -> None:
    """Results of 1 MB each, far beyond what MPI sends eagerly, arrive as they were sent."""
    launch = campaign.run("--blob", "1000000", "--seeds", "4", ranks=3)
    assert launch.exit_code == 0, launch.errors
    values = campaign.values()
    assert values == {cell: value + "x" * 1_000_000 for cell, value in expected.items() if cell[0] < 4}


def test_sigusr1_finishes_what_runs(campaign: "Campaign", expected: "Values") -> None:
    """SIGUSR1 to mpirun: the running batches are stored too, exit code 75, and the run can be completed."""
    launch = campaign.start("--seconds", "1")  # long, so that the signal comes while two batches are running
    launch.wait_for_line("stored (3, 9.0)")
    time.sleep(0.2)
    launch.signal(signal.SIGUSR1)
    launch.wait()
    assert launch.exit_code == 75, launch.errors
    # Two batches of four cells were stored, or one if the second came later, then those that were running.
    assert 12 <= len(campaign.values()) <= 16
    assert campaign.leaves_no_process()
    assert campaign.run().exit_code == 0
    assert campaign.values() == expected


def test_sigusr2_drops_what_runs(campaign: "Campaign", expected: "Values") -> None:
    """SIGUSR2 to mpirun: the end comes long before the running batches would be done, and blames no cell."""
    launch = campaign.start("--seconds", "20", "--seeds", "4")
    running = 0
    while not running:
        time.sleep(0.05)
        with suppress(sqlite3.OperationalError):  # the table does not exist yet
            ((running,),) = campaign.rows("select count(*) from running")
    start = time.monotonic()
    launch.signal(signal.SIGUSR2)
    launch.wait()
    assert launch.exit_code == 75, launch.errors
    assert time.monotonic() - start < 10.0  # of the 20 s of a batch
    assert campaign.values() == {}
    assert campaign.rows("select count(*) from running") == [(0,)]
    assert campaign.leaves_no_process()
    assert campaign.run().exit_code == 0
    assert campaign.values() == expected


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.full)])
def test_a_terminated_mpirun_ends_quickly(campaign: "Campaign", expected: "Values", number: signal.Signals) -> None:
    """SIGTERM and SIGINT to mpirun: it gives its ranks 0.25 s; nothing told of is lost."""
    launch = campaign.start("--seconds", "0.5")
    launch.wait_for_line("stored (3, 9.0)")
    start = time.monotonic()
    launch.signal(number)
    launch.wait()
    assert time.monotonic() - start < 5.0
    assert launch.exit_code != 0
    assert launch.stored() <= campaign.values().keys()
    assert campaign.leaves_no_process()
    assert campaign.run().exit_code == 0
    assert campaign.values() == expected
