"""Off Linux a campaign in one process works and ranks are refused; here Linux is made to lack what they lack."""

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Workshop

pytestmark = pytest.mark.slow

ELSEWHERE = """
import os, select, signal, sys
from importlib import import_module
for library in "jinja2 sqlalchemy.orm netCDF4 networkx numba rich.progress scipy.stats typer xarray".split():
    import_module(library)  # built for Linux, so they must not be told

sys.platform = sys.argv.pop(1)
missing = {
    "darwin": [(os, "sched_getaffinity pidfd_open"), (signal, "pidfd_send_signal")],
    "win32": [
        (os, "sched_getaffinity pidfd_open geteuid O_CLOEXEC"),
        (select, "poll POLLIN"),
        (signal, "pidfd_send_signal setitimer ITIMER_REAL SIGALRM SIGHUP SIGKILL SIGUSR1 SIGUSR2"),
    ],
}[sys.platform]
for module, names in missing:
    for name in names.split():
        delattr(module, name)
if sys.platform == "win32":
    sys.modules["fcntl"] = None

def refuse(event, arguments):
    if event == "open" and str(arguments[0]).startswith(("/proc/", "/sys/")):
        raise FileNotFoundError(arguments[0])
    if event == "ctypes.dlsym" and arguments[1] == "prctl":
        raise AttributeError("prctl")

sys.addaudithook(refuse)
from calcidem.app.cli.main import main
main()
"""
"""Runs the command without what a platform, its first argument, lacks."""


@pytest.fixture(params=[pytest.param("darwin", marks=pytest.mark.full), "win32"])
def platform(request: pytest.FixtureRequest) -> str:
    """Give a platform as `sys.platform` names it."""
    return str(request.param)


@pytest.mark.full
def test_one_process_computes_off_linux(workshop: "Workshop", platform: str) -> None:
    """A campaign in one process is computed, stored and continued; ranks are refused by the check, too."""
    workshop.configure(seeds=1, contents=(0.0,))
    done = workshop.wait(workshop.start(platform, "run", "c.toml", program=ELSEWHERE))
    assert done.code == 0, done.errors
    assert len(workshop.cells()) == 1
    again = workshop.wait(workshop.start(platform, "run", "c.toml", program=ELSEWHERE))
    assert again.code == 0, again.errors
    told = workshop.wait(workshop.start(platform, "run", "c.toml", "--check", "--ranks", "2", program=ELSEWHERE))
    assert told.code == 0, told.output + told.errors
    assert f"MPI ranks need Linux, and this is {platform}" in told.output


@pytest.mark.full
def test_ranks_are_refused_off_linux(workshop: "Workshop", platform: str) -> None:
    """With --ranks, and as a rank of mpirun, one sentence names the platform and the cure."""
    workshop.configure()
    asked = workshop.wait(workshop.start(platform, "run", "c.toml", "--ranks", "0", program=ELSEWHERE))
    workshop.variables["PMI_RANK"] = "0"
    launched = workshop.wait(workshop.start(platform, "run", "c.toml", program=ELSEWHERE))
    for refused in (asked, launched):
        assert refused.code == 2
        assert refused.errors.startswith(f"Error: MPI ranks need Linux, and this is {platform}: leave out --ranks")
        assert refused.errors.count("\n") == 1
    assert not workshop.database.exists()
