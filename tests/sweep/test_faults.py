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


def resume_twice(campaign: "Campaign", expected: "Values", *options: str, ulfm: bool = True) -> None:
    """Run the same command again until it is complete, and once more; compare with an undisturbed run."""
    assert campaign.leaves_no_process()
    for _ in range(2):
        launch = campaign.run(*options, ulfm=ulfm)
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
    assert campaign.rows("select count(*) from loss") == [(0,)]


def test_a_batch_past_its_time_limit_is_stored_as_timed_out(campaign: "Campaign") -> None:
    """The four cells that are computed side by side time out together, the rest is done."""
    launch = campaign.run("--fault", "slow", *LIMITED)
    assert launch.exit_code == 0, launch.errors
    assert campaign.rows("select status, count(*) from cell group by status") == [
        ("done", 32),
        ("timed_out", 4),
    ]


@pytest.mark.parametrize(
    ("fault", "moment"),
    [
        *(("kill", "end"), ("loop", "start")),
        *(pytest.param(*case, marks=FULL) for case in (("kill", "start"), ("loop", "end"))),
        *(pytest.param(*case, marks=FULL) for case in product(("segfault", "stop"), ("start", "end"))),
    ],
)
def test_a_lost_worker_costs_nothing_but_time(
    campaign: "Campaign", expected: "Values", tmp_path: Path, fault: str, moment: str
) -> None:
    """Under ULFM the batch of a lost worker is computed by another one and the run is complete."""
    once = tmp_path / "once"
    launch = campaign.run("--fault", fault, "--moment", moment, "--once", str(once), *LIMITED)
    assert once.exists()
    assert (launch.exit_code, launch.noted_exit_code) == (0, 0), launch.errors
    assert campaign.values() == expected
    assert campaign.rows("select distinct losses from loss") == [(1,)]
    assert campaign.leaves_no_process()


def test_a_silent_worker_is_given_up_without_a_time_limit(
    campaign: "Campaign", expected: "Values", tmp_path: Path
) -> None:
    """What the batches so far took tells when a stopped worker has been waited for long enough."""
    once = tmp_path / "once"
    launch = campaign.run("--fault", "stop", "--once", str(once), "--seconds", "0.02", "--silence-floor", "2")
    assert once.exists()
    assert launch.exit_code == 0, launch.errors
    assert "no answer within " in launch.errors  # 2 s at least, more where the batches took longer
    assert campaign.values() == expected
    assert campaign.leaves_no_process()


@pytest.mark.parametrize("moment", [pytest.param("start", marks=FULL), "end"])
def test_a_worker_that_exits_behind_the_back_of_mpi_loses_nothing(
    campaign: "Campaign", expected: "Values", tmp_path: Path, moment: str
) -> None:
    """After os._exit(1) on a worker the run completes, or mpirun ends it and the same command does."""
    options = ("--fault", "hard-exit", "--moment", moment, "--once", str(tmp_path / "once"), *LIMITED)
    launch = campaign.run(*options)
    # Seven times in eight mpirun lets the others go on, as for any lost rank; else it kills them.
    assert launch.noted_exit_code in {0, 75, None}, launch.errors
    if launch.noted_exit_code == 0:
        assert campaign.values() == expected
    resume_twice(campaign, expected, *options)


@pytest.mark.parametrize(
    "fault", ["kill", *(pytest.param(fault, marks=FULL) for fault in ("hard-exit", "segfault", "stop", "loop"))]
)
def test_a_lost_worker_without_ulfm_ends_the_run(
    campaign: "Campaign", expected: "Values", tmp_path: Path, fault: str
) -> None:
    """Without ULFM the run ends as resumable, the loss is counted, and the same command completes it."""
    options = ("--fault", fault, "--once", str(tmp_path / "once"), *LIMITED)
    launch = campaign.run(*options, ulfm=False)
    assert launch.exit_code != 0
    assert launch.noted_exit_code == 75, launch.errors
    assert campaign.rows("select seed, losses from loss order by seed") == [(4, 1), (5, 1), (6, 1), (7, 1)]
    resume_twice(campaign, expected, *options, ulfm=False)


@pytest.mark.parametrize("fault", ["kill", "loop"])
def test_a_cell_that_kills_three_workers_is_quarantined(campaign: "Campaign", expected: "Values", fault: str) -> None:
    """The deadly cell costs three workers and is stored with the reason; all other cells are done."""
    launch = campaign.run("--fault", fault, *LIMITED, ranks=5)
    assert launch.exit_code == 0, launch.errors
    ((seed, content, status, message),) = campaign.rows(
        "select seed, content, status, message from cell where status != 'done'"
    )
    assert (seed, content, status) == (*BAD_CELL, "quarantined")
    assert "took down 3 workers" in message
    assert ("hard time limit" in message) == (fault == "loop")
    assert campaign.values() == {cell: value for cell, value in expected.items() if cell != BAD_CELL}


def test_losses_count_over_restarts(campaign: "Campaign", expected: "Values") -> None:
    """With two workers the deadly cell takes down the whole pool, twice at most; then it is quarantined."""
    launch = campaign.run("--fault", "kill", *LIMITED, ranks=3)
    assert (launch.exit_code, launch.noted_exit_code) == (75, 75), launch.errors
    assert "all workers are lost" in launch.errors
    launch = campaign.run("--fault", "kill", *LIMITED, ranks=3)
    assert launch.exit_code == 0, launch.errors
    assert campaign.rows("select seed, content from cell where status = 'quarantined'") == [BAD_CELL]
    assert campaign.values() == {cell: value for cell, value in expected.items() if cell != BAD_CELL}


@pytest.mark.parametrize(
    ("fault", "moment"),
    [
        *(("kill", "while"), ("raise", "after")),
        *(pytest.param(*case, marks=FULL) for case in (("kill", "before"), ("kill", "after"))),
        *(pytest.param(*case, marks=FULL) for case in (("raise", "before"), ("raise", "while"))),
        *(pytest.param("segfault", moment, marks=FULL) for moment in ("before", "while", "after")),
    ],
)
def test_a_lost_master_loses_nothing_acknowledged(
    campaign: "Campaign", expected: "Values", fault: str, moment: str
) -> None:
    """Whatever ends the master around a commit: no process is left, and the same command completes the run."""
    launch = campaign.run("--die", f"{fault}-{moment}", "--seconds", "0.05")
    assert launch.exit_code != 0
    assert launch.noted_exit_code == (1 if fault == "raise" else None)
    assert launch.stored() <= campaign.values().keys() < expected.keys()
    resume_twice(campaign, expected)


@pytest.mark.parametrize("ulfm", [True, pytest.param(False, marks=FULL)], ids=["ulfm", "plain"])
@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGSEGV, marks=FULL)])
def test_no_rank_outlives_mpirun(campaign: "Campaign", expected: "Values", number: signal.Signals, ulfm: bool) -> None:
    """When mpirun itself is killed all ranks are gone at once, and what they had told of is stored."""
    launch = campaign.start("--seconds", "0.1", ulfm=ulfm)
    launch.wait_for_line("stored")
    launch.signal(number)
    launch.wait()
    assert campaign.leaves_no_process()
    assert launch.stored() <= campaign.values().keys()
    resume_twice(campaign, expected, ulfm=ulfm)
