"""Provenance of results: versions, machine and launch of a run."""

import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path

from calcidem.storage.records import RunRecord
from calcidem.sweep.ranks import mpi_library_version
from calcidem.version import __version__


def describe_run(ranks: int) -> RunRecord:
    """Provenance of a run that begins now, on rank 0 of this number of ranks."""
    commit, dirty = source_commit()
    versions = {"python": platform.python_version(), "calcidem": __version__}
    for name in ("numpy", "scipy", "numba", "llvmlite", "mpi4py", "sqlalchemy"):  # for numbers and files
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = ""
    if any(platform.libc_ver()):
        versions["libc"] = " ".join(platform.libc_ver())
    return RunRecord(
        versions=versions,
        host=platform.node(),
        cpu=_cpu_model(),
        ranks=ranks,
        launch_line=" ".join(sys.argv),
        started=datetime.now(UTC),
        mpi_library=mpi_library_version() if ranks > 1 else None,
        git_commit=commit,
        git_dirty=dirty,
        slurm_job_id=os.environ.get("SLURM_JOB_ID"),
    )


def _cpu_model() -> str:
    """Model name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.machine())


def source_commit() -> tuple[str | None, bool | None]:
    """Commit of the running source, and whether it was changed; None if unknown, as for most wheels."""
    root = Path(__file__).parents[3]
    if not (root / ".git").exists():  # pip records what it installed from a repository (PEP 610)
        try:
            noted = json.loads(distribution("calcidem").read_text("direct_url.json") or "{}")
        except PackageNotFoundError:
            return None, None
        installed = noted.get("vcs_info", {}).get("commit_id")
        return installed, False if installed else None
    command = ["git", "-C", str(root), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty"]
    try:
        done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=10)  # noqa: S603 - fixed
    except (OSError, subprocess.SubprocessError):  # also without git
        return None, None
    commit, _, changed = done.stdout.strip().partition("-")
    return commit, bool(changed)
