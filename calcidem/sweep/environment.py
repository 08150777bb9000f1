"""Facts about the launch of the program, for error messages, `doctor` and the provenance of a run."""

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

TERMINAL_VARIABLE = "CALCIDEM_TERMINAL"
"""Number of columns of the terminal that shows the output of the ranks; not set without one."""

NO_DEVICE_SEARCH = {"OMPI_MCA_btl": "^ofi"}
"""Settings of Open MPI by default: its search for devices for one-sided messages, which calcidem does not use, takes a
second.
"""


def launcher(variables: Mapping[str, str] = os.environ) -> str | None:
    """Return the launcher of this process as an MPI rank, or None without one."""
    return next((name for variable, name in LAUNCHER_VARIABLES.items() if variable in variables), None)


def fault_tolerance_enabled(variables: Mapping[str, str] = os.environ) -> bool:
    """Return whether MPI continues after the loss of a rank: Open MPI 5 under `mpirun --with-ft ulfm`."""
    return variables.get("OMPI_MCA_mpi_ft_enable", "0").lower() in {"1", "true", "yes"}


def available_cores() -> int:
    """Number of cores that this process may use; all cores of the machine if the system does not report it."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def refuse_ranks_off_linux(system: str | None = None) -> None:
    """Refuse several ranks on systems without support against ranks that die, stop or outlive their launcher.

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
