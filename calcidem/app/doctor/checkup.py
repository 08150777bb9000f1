"""Checks of cores, threads, Slurm, disk and caches, and all checks one after the other."""

import math
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from calcidem.app.campaign.stored_packing import CACHE_VARIABLE, cache_folder
from calcidem.app.campaign.workers import PORTABLE_ARCHITECTURES, describe_worker
from calcidem.app.config.checks import can_make_files
from calcidem.app.doctor import OK, PROBLEM, WARNING, Finding
from calcidem.app.doctor.mpi import mpi_findings
from calcidem.storage.errors import StoreError
from calcidem.storage.sql.engine import measure_commits
from calcidem.storage.sql.filesystem import filesystem_type, is_network_filesystem
from calcidem.storage.sql.lease import FileLock
from calcidem.sweep.environment import THREAD_VARIABLES, available_cores, launcher
from calcidem.sweep.progress import pluralize
from calcidem.version import __version__

_COMMITS = 20
"""Transactions that are timed."""

_SLOW_COMMITS = 20.0
"""Commits a second below which many small batches would wait for the disk."""

_LITTLE_SPACE = 1e9
"""Bytes; the database of 2,000 cells with signals takes about a tenth of it."""

_CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""Quota and period, in microseconds, of a container's CPU time (Linux, cgroup v2)."""


def findings(folder: Path) -> Iterator[Finding]:
    """Check everything, quick things first; the database is to be in this folder."""
    yield Finding(OK, "program", f"calcidem {__version__} on Python {platform.python_version()}")
    yield _processor_finding()
    if sys.platform == "linux":  # elsewhere a campaign takes one
        quota = _CPU_QUOTA.read_text(encoding="ascii") if _CPU_QUOTA.exists() else ""
        yield _cores_finding(available_cores(), quota)
    yield _thread_finding(os.environ)
    yield from _slurm_findings(os.environ)
    yield from _folder_findings(folder)
    yield _packing_cache_finding()
    yield _compile_cache_finding()
    yield from mpi_findings()


def _processor_finding() -> Finding:
    """What a worker on this machine is, and whether all machines of its kind compute the same bits."""
    worker = describe_worker(rank=0)
    if worker.architecture in PORTABLE_ARCHITECTURES:
        return Finding(OK, "processor", f"{worker.kind}; no bit of a result depends on it")
    fact = f"{worker.kind}; nobody has compared the bits of such processors"
    return Finding(WARNING, "processor", fact, "compute a campaign on machines of one kind")


def _cores_finding(cores: int, quota: str) -> Finding:
    """Compare the cores that can be seen with the CPU time that the container is given."""
    words = quota.split()
    allowed = int(words[0]) / int(words[1]) if words and words[0] != "max" else math.inf
    if allowed < cores:
        fact = f"{cores} are visible, but this container gets the CPU time of {allowed:g}"
        return Finding(WARNING, "cores", fact, f"start with --ranks {max(1, math.floor(allowed)) + 1}")
    ranks = f"'calcidem run --ranks 0' starts {cores + 1} ranks (rank 0 only coordinates)"
    return Finding(OK, "cores", f"{cores} of {os.cpu_count()} can be used, so {ranks}")


def _thread_finding(variables: Mapping[str, str]) -> Finding:
    """Look for thread counts other than 1; calcidem sets those that are not set."""
    wrong = {name: variables[name] for name in THREAD_VARIABLES if variables.get(name, "1") != "1"}
    if not wrong:
        return Finding(OK, "threads", "one per rank")
    found = ", ".join(f"{name}={value}" for name, value in wrong.items())
    return Finding(WARNING, "threads", f"{found}: the threads of the ranks compete", f"unset {' '.join(wrong)}")


def _slurm_findings(variables: Mapping[str, str]) -> Iterator[Finding]:
    """Look at the Slurm job this runs in, or say how to start one."""
    if "SLURM_JOB_ID" not in variables:
        template = "installed, but this is no job; in the script of one, 'calcidem run --ranks 0' uses all tasks"
        yield Finding(OK, "Slurm", template if shutil.which("sbatch") else "not installed here, and not needed")
        return
    tasks, job = variables.get("SLURM_NTASKS", "1"), variables["SLURM_JOB_ID"]
    if variables.get("SLURM_STEP_ID", "batch").isdigit() and tasks != "1" and launcher(variables) is None:
        fact = f"job {job}: 'srun' started {tasks} programs that don't know about each other"
        cure = "start calcidem once, with 'calcidem run --ranks 0' in the batch script, without srun"
        yield Finding(PROBLEM, "Slurm", fact, cure)
        return
    restarts = variables.get("SLURM_RESTART_COUNT", "0")
    yield Finding(OK, "Slurm", f"job {job} with {tasks} tasks, restarted {restarts} times")
    if variables.get("SLURM_JOB_NUM_NODES", "1") != "1" and shutil.which("srun") is None:
        fact = f"job {job} spans several nodes, but mpirun can't reach them without srun"
        yield Finding(PROBLEM, "Slurm", fact, "add Slurm's programs to PATH")


def _folder_findings(folder: Path) -> Iterator[Finding]:
    """Try a database in a folder: whether it can be written, its journal mode, its speed, and whether locks work."""
    where = folder.absolute()
    if not where.is_dir():
        yield Finding(PROBLEM, "folder", f"{where} is not a folder", "create it, or choose another one")
        return
    try:
        with tempfile.TemporaryDirectory(prefix=".calcidem-doctor-", dir=where) as trial:
            journal, rate = measure_commits(Path(trial) / "trial.db", _COMMITS)
            lock = FileLock(Path(trial) / "trial.db")
            locks = lock.acquire() and lock.held
            lock.release()
    except (OSError, StoreError) as error:
        cure = "free some space, change the permissions, or choose another folder"
        yield Finding(PROBLEM, "folder", f"no database can be created in {where}: {error}", cure)
        return
    kind = filesystem_type(where) or "an unknown file system"
    yield _network_finding(where, kind, network=is_network_filesystem(where), locks=locks)
    speed = f"journal mode {journal.upper()}, {rate:.0f} commits a second, each safe on disk before it counts"
    yield (
        Finding(OK, "SQLite", speed)
        if rate >= _SLOW_COMMITS
        else Finding(WARNING, "SQLite", speed, "use a faster disk, or --db with the URL of a server")
    )
    free = shutil.disk_usage(where).free
    space = f"{free / 1e9:.1f} GB free in {where}"
    yield (
        Finding(OK, "space", space)
        if free > _LITTLE_SPACE
        else Finding(WARNING, "space", space, "free some space, or choose another folder")
    )


def _network_finding(where: Path, kind: str, *, network: bool, locks: bool) -> Finding:
    """What the file system of the database means for it."""
    if not network:
        return Finding(OK, "file system", f"{where} is on {kind}, which counts as local")
    locked = "locks work" if locks else "locks don't work, so only its heartbeat reveals a second master"
    cure = "works, but commits are slower; a folder on a local disk is faster, if results can be copied back afterwards"
    return Finding(WARNING, "file system", f"{where} is on {kind}, shared between machines; {locked}", cure)


def _packing_cache_finding() -> Finding:
    """Whether packings can be kept between campaigns."""
    folder = cache_folder()
    if not can_make_files(folder):
        fact = f"{folder} is not writable: each campaign makes its packing again"
        return Finding(WARNING, "packing cache", fact, f"set {CACHE_VARIABLE} to a writable folder")
    number = len(list(folder.glob("packing-*.npz")))
    return Finding(OK, "packing cache", f"{folder} holds {pluralize(number, 'packing')}")


def _compile_cache_finding() -> Finding:
    """Where the compiled kernels are kept, and whether the ranks of a node can share them there."""
    from calcidem.dem.kernels.steps import advance_steps  # noqa: PLC0415 - takes a second to import

    stats = getattr(advance_steps, "stats", None)
    if stats is None or stats.cache_path is None:
        return Finding(WARNING, "compile cache", "none, since nothing is compiled", "unset NUMBA_DISABLE_JIT")
    folder, module = Path(stats.cache_path), advance_steps.__module__.rpartition(".")[2]
    cure = "set NUMBA_CACHE_DIR to a folder on a disk of the node"
    if not can_make_files(folder):
        return Finding(WARNING, "compile cache", f"{folder} is not writable: every rank compiles for itself", cure)
    compiled = len(list(folder.glob(f"{module}.{advance_steps.__name__}*.nbc")))
    first = "" if compiled else " (the first run compiles for 5 to 25 s)"
    fact = f"{folder} holds {pluralize(compiled, 'kernel')}{first}"
    if is_network_filesystem(folder):
        return Finding(
            WARNING, "compile cache", f"{fact}; on a network file system", f"{cure}, such as $TMPDIR in a job script"
        )
    return Finding(OK, "compile cache", fact)
