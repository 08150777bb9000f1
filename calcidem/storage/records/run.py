"""Frozen records of a run and of its processes."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from calcidem.storage.passwords import hide_passwords


@dataclass(frozen=True, slots=True)
class WorkerRecord:
    """Properties of processes on which bits could depend, one record for all equal processes of a run."""

    ranks: tuple[int, ...]
    """Ranks with these properties."""
    hosts: tuple[str, ...]
    """Their machines."""
    architecture: str
    """Family of the processor, such as ``x86_64``."""
    processor: str
    """LLVM's name of the processor for which kernels are compiled, such as ``znver4``."""
    features: tuple[str, ...]
    """LLVM's names of the processor features that kernels may use."""
    blas_core: str | None
    """Processor for which OpenBLAS has chosen its kernels; None for another BLAS."""
    numpy_simd: tuple[str, ...]
    """Instruction sets beyond its baseline for which numpy has chosen functions."""
    versions: Mapping[str, str]
    """Versions of Python, calcidem, its physics and the libraries on which numbers depend."""

    def __post_init__(self) -> None:
        """Convert lists from JSON to tuples."""
        for name in ("ranks", "hosts", "features", "numpy_simd"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def kind(self) -> str:
        """Describe these processes in one line."""
        blas = "BLAS unknown" if self.blas_core is None else f"OpenBLAS {self.blas_core}"
        simd = self.numpy_simd[-1] if self.numpy_simd else "baseline"
        return f"{self.processor} ({self.architecture}, {len(self.features)} features), {blas}, numpy {simd}"

    @property
    def places(self) -> str:
        """Their machines; of many only the first three."""
        more = len(self.hosts) - 3
        return ", ".join(self.hosts[:3]) + (f" and {more} more" if more > 0 else "")


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
    workers: tuple[WorkerRecord, ...] = ()
    """Description of its processes, one record for all equal ones; empty if not recorded."""

    def __post_init__(self) -> None:
        """Convert mappings from JSON to workers."""
        known = (
            worker if isinstance(worker, WorkerRecord) else WorkerRecord(**worker) for worker in self.workers or ()
        )
        object.__setattr__(self, "workers", tuple(known))
        object.__setattr__(self, "launch_line", hide_passwords(self.launch_line))
        object.__setattr__(self, "started", as_utc(self.started))
        if self.ended is not None:
            object.__setattr__(self, "ended", as_utc(self.ended))


def as_utc(moment: datetime) -> datetime:
    """Return a time in UTC; `ValueError` for a time without time zone, which is ambiguous."""
    if moment.tzinfo is None:
        raise ValueError(f"{moment} has no time zone; use datetime.now(UTC).")
    return moment.astimezone(UTC)
