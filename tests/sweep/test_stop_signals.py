import signal
import time
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Campaign, Values

pytestmark = pytest.mark.mpi

BATCH = 0.5
"""Seconds of a batch; long against everything else, so that the signal comes while two are running."""


@pytest.mark.parametrize("ulfm", [pytest.param(True, marks=pytest.mark.full), False], ids=["ulfm", "plain"])
def test_sigusr1_finishes_what_runs(campaign: "Campaign", expected: "Values", ulfm: bool) -> None:
    """SIGUSR1 to mpirun: the running batches are stored too, exit code 75, and the run can be completed."""
    launch = campaign.start("--seconds", str(BATCH), ulfm=ulfm)
    launch.wait_for_line("stored (3, 9.0)")
    time.sleep(0.2)
    launch.signal(signal.SIGUSR1)
    launch.wait()
    assert (launch.exit_code, launch.noted_exit_code) == (75, 75), launch.errors
    # Two batches of four cells were stored, or one if the second came later, then those that were running.
    assert 12 <= len(campaign.values()) <= 16
    assert campaign.leaves_no_process()
    assert campaign.run(ulfm=ulfm).exit_code == 0
    assert campaign.values() == expected


@pytest.mark.parametrize("ulfm", [True, pytest.param(False, marks=pytest.mark.full)], ids=["ulfm", "plain"])
def test_sigusr2_drops_what_runs(campaign: "Campaign", expected: "Values", ulfm: bool) -> None:
    """SIGUSR2 to mpirun: the end comes long before the running batches would be done, with 75."""
    launch = campaign.start("--seconds", "5", "--seeds", "4", ulfm=ulfm)
    launch.wait_for_ranks()
    time.sleep(0.5)
    start = time.monotonic()
    launch.signal(signal.SIGUSR2)
    launch.wait()
    assert (launch.exit_code, launch.noted_exit_code) == (75, 75), launch.errors
    assert time.monotonic() - start < 4.0  # of the 5 s of a batch
    assert campaign.values() == {}
    assert campaign.leaves_no_process()
    assert campaign.run(ulfm=ulfm).exit_code == 0
    assert campaign.values() == expected


@pytest.mark.parametrize("ulfm", [True, pytest.param(False, marks=pytest.mark.full)], ids=["ulfm", "plain"])
@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.full)])
def test_a_terminated_mpirun_ends_quickly(
    campaign: "Campaign", expected: "Values", number: signal.Signals, ulfm: bool
) -> None:
    """SIGTERM and SIGINT to mpirun: it gives its ranks 0.25 s; nothing told of is lost, no cell is blamed."""
    launch = campaign.start("--seconds", str(BATCH), ulfm=ulfm)
    launch.wait_for_line("stored (3, 9.0)")
    start = time.monotonic()
    launch.signal(number)
    launch.wait()
    assert time.monotonic() - start < 2.0
    assert launch.exit_code != 0
    assert launch.noted_exit_code in {None, 75}
    assert launch.stored() <= campaign.values().keys()
    assert campaign.rows("select count(*) from loss") == [(0,)]
    assert campaign.leaves_no_process()
    assert campaign.run(ulfm=ulfm).exit_code == 0
    assert campaign.values() == expected
