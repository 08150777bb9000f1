"""What a campaign needs of a machine, each point checked by trying it out."""

import math
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from sqlalchemy import text
from sqlalchemy.exc import SQLAlchemyError

from calcidem.app.campaign.packing import CACHE_VARIABLE, cache_folder
from calcidem.app.campaign.provenance import version_of
from calcidem.app.doctor.finding import Finding, Verdict
from calcidem.app.doctor.mpi import mpi_findings
from calcidem.storage.sql.engine import WRITES, make_engine, parse_address
from calcidem.storage.sql.filesystem import filesystem_type, is_network_filesystem
from calcidem.storage.sql.lease import FileLock
from calcidem.sweep.environment import THREAD_VARIABLES, launcher

COMMITS = 20
"""Transactions that are timed."""

SLOW_COMMITS = 20.0
"""Commits a second below which many small batches would wait for the disk."""

LITTLE_SPACE = 1e9
"""Bytes; the database of 2,000 cells with signals takes about a tenth of it."""

CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""Quota and period, in microseconds, of a container's CPU time (Linux, cgroup v2)."""


def findings(folder: Path) -> Iterator[Finding]:
    """Check everything, quick things first.

    Parameters
    ----------
    folder
        In which the database is to be.
    """
    yield Finding(Verdict.OK, "program", f"calcidem {version_of('calcidem')} on Python {platform.python_version()}")
    yield cores_finding(len(os.sched_getaffinity(0)), read_or_empty(CPU_QUOTA))
    yield from thread_findings(os.environ)
    yield from slurm_findings(os.environ)
    yield from folder_findings(folder)
    yield packing_cache_finding()
    yield compile_cache_finding()
    yield from mpi_findings()


def read_or_empty(path: Path) -> str:
    """Text of a file, empty if it can't be read."""
    try:
        return path.read_text(encoding="ascii")
    except OSError:
        return ""


def cores_finding(cores: int, quota: str) -> Finding:
    """Compare the cores that can be seen with the CPU time that the container is given."""
    fact = f"{cores} of {os.cpu_count()} can be used, so './mpirun.sh' starts {cores + 1} ranks (rank 0 sleeps)"
    words = quota.split()
    allowed = int(words[0]) / int(words[1]) if words and words[0] != "max" else math.inf
    if allowed < cores:
        return Finding(
            Verdict.WARNING,
            "cores",
            f"{cores} can be seen, but this container gets the CPU time of {allowed:g}",
            f"start with --ranks {max(1, math.floor(allowed)) + 1}",
        )
    return Finding(Verdict.OK, "cores", fact)


def thread_findings(variables: Mapping[str, str]) -> Iterator[Finding]:
    """Look for thread counts other than 1; calcidem sets those that are not set."""
    wrong = {name: variables[name] for name in THREAD_VARIABLES if variables.get(name, "1") != "1"}
    if wrong:
        yield Finding(
            Verdict.WARNING,
            "threads",
            ", ".join(f"{name}={value}" for name, value in wrong.items())
            + ": threads of the ranks fight for the cores",
            f"unset {' '.join(wrong)}",
        )
    else:
        yield Finding(Verdict.OK, "threads", "one for each rank")


def slurm_findings(variables: Mapping[str, str]) -> Iterator[Finding]:
    """Look at the Slurm job this runs in, or say how to start one."""
    if "SLURM_JOB_ID" not in variables:
        present = shutil.which("sbatch") is not None
        fact = "is there, but this is no job of it" if present else "is not installed here, and not needed"
        yield Finding(Verdict.OK, "Slurm", fact + (": examples/slurm.sbatch is a job to start from" if present else ""))
        return
    tasks, job = variables.get("SLURM_NTASKS", "1"), variables["SLURM_JOB_ID"]
    if variables.get("SLURM_STEP_ID", "batch").isdigit() and tasks != "1" and launcher(variables) is None:
        yield Finding(
            Verdict.PROBLEM,
            "Slurm",
            f"job {job}: 'srun' started {tasks} programs that don't know of one another",
            "start calcidem once, with ./mpirun.sh or 'calcidem run --ranks 0' in the batch script, without srun",
        )
        return
    restarts = variables.get("SLURM_RESTART_COUNT", "0")
    yield Finding(Verdict.OK, "Slurm", f"job {job} with {tasks} tasks, started anew {restarts} times")
    if variables.get("SLURM_JOB_NUM_NODES", "1") != "1" and shutil.which("srun") is None:
        yield Finding(
            Verdict.PROBLEM,
            "Slurm",
            f"job {job} has several nodes, but mpirun can't reach them without the program srun",
            "add Slurm's programs to PATH",
        )


def folder_findings(folder: Path) -> Iterator[Finding]:
    """Try a database in a folder: may it be written, in which journal mode, how fast, and do locks work there."""
    where = folder.absolute()
    if not where.is_dir():
        yield Finding(Verdict.PROBLEM, "folder", f"{where} is no folder", "make it, or give another one")
        return
    network = is_network_filesystem(where)
    kind = filesystem_type(where) or "unknown"
    try:
        with tempfile.TemporaryDirectory(prefix=".calcidem-doctor-", dir=where) as trial:
            journal, rate = try_database(Path(trial) / "trial.db")
            lock = FileLock(Path(trial) / "trial.db")
            locks = lock.acquire() and lock.held
            lock.release()
    except (OSError, SQLAlchemyError) as error:
        cure = "free some space or change the permissions, or give another folder"
        yield Finding(Verdict.PROBLEM, "folder", f"no database can be made in {where}: {error}", cure)
        return
    yield network_finding(where, kind, network=network, locks=locks)
    yield database_finding(journal, rate)
    free = shutil.disk_usage(where).free
    verdict, cure = (Verdict.OK, "") if free > LITTLE_SPACE else (Verdict.WARNING, "free some, or give another folder")
    yield Finding(verdict, "space", f"{free / 1e9:.1f} GB are free in {where}", cure)


def network_finding(where: Path, kind: str, *, network: bool, locks: bool) -> Finding:
    """What the file system of the database means for it."""
    if not network:
        return Finding(Verdict.OK, "file system", f"{where} is on {kind}, which counts as local")
    locked = "locks work" if locks else "locks don't work, so a second master is told by its heartbeat alone"
    return Finding(
        Verdict.WARNING,
        "file system",
        f"{where} is on {kind}, shared between machines; {locked}",
        "works, but commits are slower; a folder on a local disk is faster if the job's results can be copied back",
    )


def database_finding(journal: str, rate: float) -> Finding:
    """What the trial of a database showed."""
    fact = f"journal mode {journal.upper()}, {rate:.0f} commits a second, each safe on disk before it counts"
    if rate < SLOW_COMMITS:
        return Finding(Verdict.WARNING, "SQLite", fact, "use a faster disk, or --db with the URL of a server")
    return Finding(Verdict.OK, "SQLite", fact)


def try_database(path: Path) -> tuple[str, float]:
    """Make a database as a campaign does; return its journal mode and how many commits it does a second."""
    engine = make_engine(parse_address(path), read_only=False)
    try:
        with engine.execution_options(**{WRITES: True}).connect() as connection:
            journal = str(connection.execute(text("PRAGMA journal_mode")).scalar())
            connection.execute(text("CREATE TABLE trial (value BLOB)"))
            connection.commit()
            begin = time.perf_counter()
            for _ in range(COMMITS):
                connection.execute(text("INSERT INTO trial VALUES (zeroblob(8000))"))
                connection.commit()
            return journal, COMMITS / (time.perf_counter() - begin)
    finally:
        engine.dispose()


def packing_cache_finding() -> Finding:
    """Whether packings can be kept between campaigns."""
    folder = cache_folder()
    existing = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    if not os.access(existing, os.W_OK):
        cure = f"set {CACHE_VARIABLE} to a folder that can be written"
        return Finding(Verdict.WARNING, "packing cache", f"{folder} can't be written: packings are made anew", cure)
    number = len(list(folder.glob("packing-*.npz")))
    return Finding(Verdict.OK, "packing cache", f"{folder}, packings in it: {number}")


def compile_cache_finding() -> Finding:
    """Where the compiled kernels are kept, and whether the ranks of a node can share them there."""
    from calcidem.dem.kernels.steps import sweep  # noqa: PLC0415 - takes a second to import

    stats = getattr(sweep, "stats", None)
    if stats is None or stats.cache_path is None:
        return Finding(Verdict.WARNING, "compile cache", "none, since nothing is compiled", "unset NUMBA_DISABLE_JIT")
    folder = Path(stats.cache_path)
    compiled = len(list(folder.glob("sweep.sweep*.nbc")))
    fact = f"{folder}, kernels in it: {compiled}" + ("" if compiled else " (the first run compiles for 5 to 25 s)")
    existing = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    if not os.access(existing, os.W_OK):
        cure = "set NUMBA_CACHE_DIR to a folder on a disk of the node"
        return Finding(Verdict.WARNING, "compile cache", f"{folder} can't be written: every rank compiles", cure)
    if is_network_filesystem(folder):
        cure = "set NUMBA_CACHE_DIR to a folder on a disk of the node, as examples/slurm.sbatch does"
        return Finding(Verdict.WARNING, "compile cache", f"{fact}; on a network file system", cure)
    return Finding(Verdict.OK, "compile cache", fact)
