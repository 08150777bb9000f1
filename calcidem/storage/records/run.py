"""Frozen records of a run and of its processes."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from typing import Any, Self

from calcidem.storage.passwords import hide_passwords

_NAMED_HOSTS = 3
"""Machines of one kind that are named where there are many."""


@dataclass(frozen=True, slots=True)
class WorkerRecord:
    """What bits could depend on in the processes of a run, once for all that are alike."""

    ranks: tuple[int, ...]
    """Ranks that are like this."""
    hosts: tuple[str, ...]
    """Machines that they are on."""
    architecture: str
    """Family of the processor, such as ``x86_64``."""
    processor: str
    """LLVM's name of the processor that kernels are compiled for, such as ``znver4``."""
    features: tuple[str, ...]
    """LLVM's names of its features that kernels may use."""
    versions: Mapping[str, str]
    """Of Python, calcidem, its physics and the libraries that numbers depend on."""

    def __post_init__(self) -> None:
        """Take lists, as JSON has them, for tuples."""
        for name in ("ranks", "hosts", "features"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def kind(self) -> str:
        """What these processes are, in a line."""
        return f"{self.processor} ({self.architecture}, {len(self.features)} features)"

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """Take what was stored; names that an earlier calcidem stored as well are left out."""
        return cls(**{entry.name: stored[entry.name] for entry in fields(cls)})

    @property
    def places(self) -> str:
        """Their machines, only the first of many."""
        more = len(self.hosts) - _NAMED_HOSTS
        return ", ".join(self.hosts[:_NAMED_HOSTS]) + (f" and {more} more" if more > 0 else "")


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
    """Command line; a password in it is not kept."""
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
    """None while it runs, and for ever if it was killed."""
    exit_state: str | None = None
    """How it ended, in the words of the program."""
    workers: tuple[WorkerRecord, ...] = ()
    """What its processes were, one record for all that are alike; empty if that was not recorded."""

    def __post_init__(self) -> None:
        """Take mappings, as JSON has them, for workers."""
        known = (
            worker if isinstance(worker, WorkerRecord) else WorkerRecord.from_json(worker)
            for worker in self.workers or ()
        )
        object.__setattr__(self, "workers", tuple(known))
        object.__setattr__(self, "launch_line", hide_passwords(self.launch_line))
        object.__setattr__(self, "started", as_utc(self.started))
        if self.ended is not None:
            object.__setattr__(self, "ended", as_utc(self.ended))


def as_utc(moment: datetime) -> datetime:
    """Return the moment in UTC; `ValueError` for a moment without time zone: it could mean anything."""
    if moment.tzinfo is None:
        raise ValueError(f"{moment} has no time zone; use datetime.now(UTC).")
    return moment.astimezone(UTC)
