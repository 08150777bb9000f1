"""A campaign on an executor has the bits of one in a single process."""

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from places import CHECKOUT

from calcidem.app.cli.exit_codes import tell_error
from calcidem.sweep.schedule import SweepError

if TYPE_CHECKING:
    from conftest import Cells, Workshop

POOL = """
import multiprocessing, sys, calcidem
from concurrent.futures import ProcessPoolExecutor
if __name__ == "__main__":
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        calcidem.run("c.toml", executor=pool).close()
"""

KILLED_ONCE = """
import multiprocessing, os, signal, time, calcidem
from calcidem.sweep import workers
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
attempt, begun = workers.attempt, []
def hold(batch, *arguments):
    begun.append(batch)
    end = time.monotonic() + 120.0
    while len(begun) > 1 and not Path("killed").exists() and time.monotonic() < end:
        time.sleep(0.05)
    return attempt(batch, *arguments)
workers.attempt = hold
def run():
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        def kill(progress):
            if progress.finished >= 2 and not killed:
                killed.append(next(iter(pool._processes)))
                os.kill(killed[0], signal.SIGKILL)
                Path("killed").touch()
        calcidem.run("c.toml", executor=pool, progress=kill).close()
if __name__ == "__main__":
    killed = []
    try:
        run()
    except calcidem.WorkersLostError as error:
        print(error)
    assert killed
    run()
"""
"""Batches after a worker's first wait until one of the workers is killed: all might be over before."""

MPI_POOL = """
import sys, calcidem
from mpi4py.futures import MPIPoolExecutor
if __name__ == "__main__":
    with MPIPoolExecutor() as pool:
        calcidem.run("c.toml", executor=pool).close()
"""


FROM_FILE = "import runpy; runpy.run_path('pool.py', run_name='__main__')"


@pytest.mark.full
def test_a_process_pool_gives_the_same_bits(workshop: "Workshop", expected: "Cells") -> None:
    """Every outcome equals that of one process, signals and cement included."""
    workshop.configure()
    (workshop.folder / "pool.py").write_text(POOL)
    done = workshop.wait(workshop.start(program=FROM_FILE))
    assert done.code == 0, done.errors
    assert workshop.cells() == expected


@pytest.mark.full
def test_a_killed_process_of_a_pool_costs_a_second_call(workshop: "Workshop", expected: "Cells") -> None:
    """The call ends with an error that says so, everything stored stays, and the next call computes the rest."""
    workshop.configure()
    (workshop.folder / "pool.py").write_text(KILLED_ONCE)
    done = workshop.wait(workshop.start(program=FROM_FILE))
    assert done.code == 0, done.errors
    assert "a worker was lost" in done.output
    assert workshop.cells() == expected


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_killed_master_of_forked_workers_leaves_no_process_and_no_lock(
    workshop: "Workshop", expected: "Cells"
) -> None:
    """Forked workers share the lock of their master, and wait for ever for its next batch."""
    workshop.configure()
    (workshop.folder / "pool.py").write_text(POOL.replace('"spawn"', '"fork"'))
    process = workshop.start(program=FROM_FILE)
    workshop.wait_for_cells(1)
    process.kill()
    process.wait()
    done = workshop.run("run", "c.toml")
    assert done.code == 0, done.errors
    assert workshop.cells() == expected
    assert workshop.leaves_no_process()


@pytest.mark.full
@pytest.mark.mpi
def test_a_pool_of_mpi_gives_the_same_bits(workshop: "Workshop", expected: "Cells") -> None:
    """Ranks of mpi4py.futures compute for the one that runs the script."""
    workshop.configure()
    script = workshop.folder / "pool.py"
    script.write_text(MPI_POOL)
    mpirun = Path(sys.executable).with_name("mpirun")
    command = [mpirun, "--allow-run-as-root", "--map-by", ":OVERSUBSCRIBE", "-n", "3", sys.executable]
    variables = {"PYTHONPATH": str(CHECKOUT), "CALCIDEM_CACHE": str(workshop.cache), "OMPI_MCA_btl": "^ofi"}
    done = subprocess.run(
        [*command, "-m", "mpi4py.futures", str(script)],
        cwd=workshop.folder,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert workshop.cells() == expected


def test_workers_without_calcidem_end_the_command_with_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    """The exit code is 1, since the same command would meet it again; there is neither a traceback nor a log."""
    assert tell_error(SweepError("A worker of the executor could not compute a batch")) == 1
    assert capsys.readouterr().err == "Error: A worker of the executor could not compute a batch\n"
