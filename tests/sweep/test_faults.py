"""The fault matrix, with the real mpirun: {what happens} x {to whom} x {when}, then the same command again, twice.

The cell (5, 2.55) is the one that misbehaves; `--once` lets it do so a single time.
"""

import signal
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Campaign, Values

pytestmark = pytest.mark.mpi

BAD_CELL = (5, 2.55)
FULL = pytest.mark.full
LIMITED = ("--time-limit", "0.6", "--seconds", "0.02")


def resume_twice(campaign: "Campaign", expected: "Values", *options: str) -> None:
    """Run the same command again until it is complete, and once more; compare with an undisturbed run."""
    assert campaign.leaves_no_process()
    for ranks in (3, 1):  # the last has nothing to compute
        launch = campaign.run(*options, ranks=ranks)
        assert launch.exit_code == 0, launch.errors
        assert campaign.values() == expected
        assert campaign.leaves_no_process()


@pytest.mark.parametrize("fault", [pytest.param("raise", marks=FULL), pytest.param("exit", marks=FULL), "unpicklable"])
def test_an_exception_on_a_worker_costs_its_cell(campaign: "Campaign", expected: "Values", fault: str) -> None:
    """The bad cell alone is stored as failed; the run is complete; no worker is lost."""
    launch = campaign.run("--fault", fault)
    assert launch.exit_code == 0, launch.errors
    assert campaign.rows("select seed, content, status from cell where status != 'done'") == [(*BAD_CELL, "failed")]
    assert campaign.values() == {cell: value for cell, value in expected.items() if cell != BAD_CELL}
    assert campaign.rows("select count(*) from running") == [(0,)]


def test_a_batch_past_its_time_limit_is_stored_as_timed_out(campaign: "Campaign") -> None:
    """The four cells that are computed side by side time out together, the rest is done."""
    launch = campaign.run("--fault", "slow", *LIMITED)
    assert launch.exit_code == 0, launch.errors
    assert campaign.rows("select status, count(*) from cell group by status") == [("done", 32), ("timed_out", 4)]


@pytest.mark.parametrize(
    ("fault", "moment"),
    [
        ("kill", "end"),
        ("loop", "start"),
        *(pytest.param(*case, marks=FULL) for case in (("kill", "start"), ("loop", "end"))),
        *(pytest.param(*case, marks=FULL) for case in product(("segfault", "stop", "hard-exit"), ("start", "end"))),
    ],
)
def test_a_lost_worker_ends_the_run(
    campaign: "Campaign", expected: "Values", tmp_path: Path, fault: str, moment: str
) -> None:
    """Whether it dies, hangs in machine code or is stopped: all ends, and the same command completes the run."""
    options = ("--fault", fault, "--moment", moment, "--once", str(tmp_path / "once"), *LIMITED)
    launch = campaign.run(*options)
    assert (tmp_path / "once").exists()
    assert launch.exit_code != 0, launch.errors
    assert launch.stored() <= campaign.values().keys()
    resume_twice(campaign, expected, *options)


def test_a_silent_worker_is_given_up_without_a_time_limit(
    campaign: "Campaign", expected: "Values", tmp_path: Path
) -> None:
    """What the batches so far took tells when a stopped worker has been waited for long enough."""
    options = ("--fault", "stop", "--once", str(tmp_path / "once"), "--seconds", "0.02")
    launch = campaign.run(*options, "--silence-floor", "0.5")  # it is waited for ten times as long in its first batch
    assert launch.exit_code == 75, launch.errors
    assert "a worker has not answered within " in launch.errors
    resume_twice(campaign, expected, *options)


@pytest.mark.parametrize("fault", ["kill", pytest.param("loop", marks=FULL)])
def test_a_cell_that_is_computed_at_three_deaths_is_not_tried_again(
    campaign: "Campaign", expected: "Values", fault: str
) -> None:
    """The deadly cell costs three runs; the fourth leaves it out, and all other cells are done."""
    # The second and third run begin with its batch, which may load libraries for as long as the floor says.
    options = ("--fault", fault, *LIMITED, "--silence-floor", "1")
    for death in range(3):
        launch = campaign.run(*options)
        assert launch.exit_code != 0, launch.errors
        (most,) = campaign.rows("select count(distinct run) from running where seed = 5 and content = 2.55")
        assert most == (death + 1,)
    launch = campaign.run(*options)
    assert launch.exit_code == 0, launch.errors
    assert f"deadly: [{BAD_CELL}]" in launch.errors
    assert campaign.values() == {cell: value for cell, value in expected.items() if cell != BAD_CELL}


@pytest.mark.parametrize(
    ("fault", "moment"),
    [
        ("kill", "while"),
        ("raise", "after"),
        *(pytest.param(*case, marks=FULL) for case in (("kill", "before"), ("kill", "after"))),
        *(pytest.param(*case, marks=FULL) for case in (("raise", "before"), ("raise", "while"))),
        *(pytest.param("segfault", moment, marks=FULL) for moment in ("before", "while", "after")),
    ],
)
def test_a_lost_master_loses_nothing_acknowledged(
    campaign: "Campaign", expected: "Values", fault: str, moment: str
) -> None:
    """Whatever ends the master around a commit: no process is left, and the same command completes the run."""
    launch = campaign.run("--die", f"{fault}-{moment}", "--seconds", "0.3")
    assert launch.exit_code != 0
    assert launch.stored() <= campaign.values().keys() < expected.keys()
    resume_twice(campaign, expected)


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGSEGV, marks=FULL)])
def test_no_rank_outlives_mpirun(campaign: "Campaign", expected: "Values", number: signal.Signals) -> None:
    """When mpirun itself is killed all ranks are gone at once, and what they had told of is stored."""
    launch = campaign.start("--seconds", "0.1")
    launch.wait_for_line("stored")
    launch.signal(number)
    launch.wait()
    assert campaign.leaves_no_process()
    assert launch.stored() <= campaign.values().keys()
    resume_twice(campaign, expected)
