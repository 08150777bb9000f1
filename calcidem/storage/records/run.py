"""Frozen record of a run."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from calcidem.storage.passwords import hide_passwords


@dataclass(frozen=True, slots=True)
class RunRecord:
    """Provenance of one run of the program on a campaign."""

    versions: Mapping[str, str]
    """Versions of Python, calcidem and the libraries its numbers depend on."""
    host: str
    cpu: str
    """Host of rank 0 and its CPU model."""
    ranks: int
    """Size of the MPI world, 1 without MPI."""
    launch_line: str
    """Command line without passwords."""
    started: datetime
    """With time zone; kept as UTC."""
    mpi_library: str | None = None
    """None without MPI."""
    git_commit: str | None = None
    """Commit of the source tree, None when installed from a package."""
    git_dirty: bool | None = None
    """Whether that tree had uncommitted changes."""
    slurm_job_id: str | None = None
    ended: datetime | None = None
    """Time of the end; None while the run lasts, or if it was killed."""
    exit_state: str | None = None
    """Description of the end."""

    def __post_init__(self) -> None:
        """Hide passwords, and refuse times without time zone."""
        object.__setattr__(self, "launch_line", hide_passwords(self.launch_line))
        object.__setattr__(self, "started", as_utc(self.started))
        if self.ended is not None:
            object.__setattr__(self, "ended", as_utc(self.ended))


def as_utc(moment: datetime) -> datetime:
    """Return a time in UTC; `ValueError` for a time without time zone, which is ambiguous."""
    if moment.tzinfo is None:
        raise ValueError(f"{moment} has no time zone; use datetime.now(UTC).")
    return moment.astimezone(UTC)
