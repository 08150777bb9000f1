"""Facts about the launch of the program, for error messages and the provenance of a run."""

import os
import sys
from collections.abc import Mapping

from calcidem.sweep.sweep_end import LaunchError

LAUNCHER_VARIABLES = {
    "OMPI_COMM_WORLD_SIZE": "Open MPI mpirun",
    "MPI_LOCALNRANKS": "MPICH mpiexec",
    "PMI_RANK": "a PMI launcher",
    "PMIX_RANK": "a PMIx launcher",
}
"""Environment variables that a launcher sets for its ranks; the first that is set counts."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Must be 1 before numpy is imported: each rank has one core, for which threads would compete."""

COMMAND_VARIABLE = "CALCIDEM_COMMAND"
"""Set for ranks that `calcidem run --ranks` starts: the command itself shows their progress and the results."""


def launcher(variables: Mapping[str, str] = os.environ) -> str | None:
    """Return the launcher of this process as an MPI rank, or None without one."""
    return next((name for variable, name in LAUNCHER_VARIABLES.items() if variable in variables), None)


def own_rank(variables: Mapping[str, str] = os.environ) -> int | None:
    """Return the number of this MPI rank, from 0, None without one; `LaunchError` as `whole_number`."""
    names = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")
    ranks = (whole_number(name, 100_000, variables, least=0) for name in names)
    return next((rank for rank in ranks if rank is not None), None)


def whole_number(name: str, largest: int, variables: Mapping[str, str] = os.environ, *, least: int = 1) -> int | None:
    """Return the whole number from `least` to `largest` in an environment variable, None if it is not set or empty.

    `LaunchError` for any other value.
    """
    text = variables.get(name, "").strip()
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and len(text) <= len(str(largest)) and least <= int(text) <= largest):
        raise LaunchError(f"{name}={text}: set it to a whole number from {least} to {largest}, or unset it")
    return int(text)


def requested_tasks(variables: Mapping[str, str] = os.environ) -> int | None:
    """Return the number of tasks of this Slurm job, None outside of Slurm; `LaunchError` as `whole_number`."""
    return whole_number("SLURM_NTASKS", 100_000, variables)


def refuse_singletons(variables: Mapping[str, str] = os.environ) -> None:
    """Refuse to run alone as one of several tasks.

    `srun python` starts N independent programs, each of which would compute the whole campaign. `LaunchError` if this
    process is a task of a step of several, or of a job of several without a step, and no MPI launcher started it. The
    shell that `salloc` opens is a step of one task.
    """
    name = "SLURM_STEP_NUM_TASKS" if variables.get("SLURM_STEP_NUM_TASKS") else "SLURM_NTASKS"
    tasks = whole_number(name, 100_000, variables) or 1
    if tasks > 1 and launcher(variables) is None:
        raise LaunchError(
            f"{name} is {tasks}, but this process is the only MPI rank: `srun python` starts independent programs; use "
            "--ranks 0 or mpirun inside the job, `srun --mpi=pmix`, or ask for one task"
        )


def available_cores() -> int:
    """Number of cores that this process may use; all cores of the machine if the system does not report it."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def refuse_ranks_off_linux(system: str | None = None) -> None:
    """Refuse several ranks on systems without support against ranks that outlive their launcher.

    `LaunchError` unless it is Linux.
    """
    system = system or sys.platform
    if system != "linux":
        raise LaunchError(
            f"MPI ranks need Linux, and this is {system}: leave out --ranks and mpirun to compute in one process, or"
            " use Linux, in a container or WSL 2 for instance"
        )


def mpi_library_version() -> str | None:
    """Return the first line of the version text of the MPI library, or None if it cannot be loaded.

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
