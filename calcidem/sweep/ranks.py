"""MPI ranks as an executor: rank 0 coordinates, all others compute what it submits.

Also facts about the launch of a process, of any kind, and what the operating system (Linux) does for processes.
"""

import contextlib
import ctypes
import os
import platform
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import partial
from typing import TYPE_CHECKING, Any

from calcidem.sweep.schedule import EXIT_COMPLETE, EXIT_ERROR, EXIT_RESUMABLE, IS_INTERRUPTED, LaunchError, StopRequest

if TYPE_CHECKING:
    from mpi4py import MPI


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
    ranks = (whole_number(name, variables, least=0) for name in names)
    return next((rank for rank in ranks if rank is not None), None)


def whole_number(name: str, variables: Mapping[str, str] = os.environ, *, least: int = 1) -> int | None:
    """Return the whole number up to 100,000 in an environment variable, None if it is not set or empty.

    `LaunchError` for any other value, or one below `least`.
    """
    text = variables.get(name, "").strip()
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and len(text) <= 6 and least <= int(text) <= 100_000):
        raise LaunchError(f"{name}={text}: set it to a whole number from {least} to 100000, or unset it")
    return int(text)


def refuse_singletons(variables: Mapping[str, str] = os.environ) -> None:
    """Refuse to run alone as one of several tasks.

    `srun python` starts N independent programs, each of which would compute the whole campaign. `LaunchError` if this
    process is a task of a step of several, or of a job of several without a step, and no MPI launcher started it. The
    shell that `salloc` opens is a step of one task.
    """
    name = "SLURM_STEP_NUM_TASKS" if variables.get("SLURM_STEP_NUM_TASKS") else "SLURM_NTASKS"
    tasks = whole_number(name, variables) or 1
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


# Loaded here, since the next function also runs between fork and exec.
_LIBC: Any = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


def die_with_parent(parent: int | None = None) -> None:
    """Let the kernel kill this process as soon as its parent ends.

    Otherwise a rank whose mpirun was killed would run for ever. It is a descendant of mpirun or, on other nodes, of its
    daemon, which ends when it loses mpirun. Call this before MPI is initialised: if the launcher has ended by then, MPI
    leaves the rank alone, which `run_on_ranks` refuses. A caller that knows the process number of its parent gives it,
    since the parent may have ended before this call. `OSError` if the kernel refuses.
    """
    parent = parent or os.getppid()
    if _LIBC.prctl(1, signal.SIGKILL, 0, 0, 0) != 0:  # PR_SET_PDEATHSIG
        number = ctypes.get_errno()
        raise OSError(number, f"prctl(PR_SET_PDEATHSIG): {os.strerror(number)}")
    if os.getppid() != parent:  # it ended before the request, so its death will not be signalled
        os.kill(os.getpid(), signal.SIGKILL)


def exists(process: int) -> bool:
    """Whether a process of this machine with this number exists."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def end_after(process: int, grace: float, exit_code: int) -> None:
    """End this process some seconds after the end of another one of this machine, unless it ends by itself.

    A thread waits for this. `srun` does not end a job when one of its tasks is killed, as mpirun does, nor does a pool
    end when its master is.
    """
    try:
        descriptor = os.pidfd_open(process)
    except (OSError, AttributeError):
        return  # another system, before Linux 5.3, or it has just ended and MPI is being informed

    def wait_and_end() -> None:
        select.select([descriptor], [], [])
        time.sleep(grace)
        os._exit(exit_code)

    threading.Thread(target=wait_and_end, name="watch-master", daemon=True).start()


def keep_freed_memory() -> None:
    """Let the C library keep the memory of freed arrays for later ones (glibc; elsewhere without effect).

    By default it returns memory to the kernel at once, and the kernel fills it with zeros at each new request. For
    arrays of some hundred kilobytes this takes half of NumPy's time.
    """
    with contextlib.suppress(OSError, AttributeError):
        _LIBC.mallopt(-1, 1 << 27)  # M_TRIM_THRESHOLD, bytes
        _LIBC.mallopt(-3, 1 << 25)  # M_MMAP_THRESHOLD; some versions of glibc refuse more


def run_on_ranks(lead: Callable[[Executor | None, StopRequest], int], grace: float = 3.0) -> int:
    """Call `lead` with an executor of all other ranks and the requests to stop; return the exit code of this process.

    Without an MPI launcher, or with one rank, there is no executor. All ranks call this; `lead` runs on rank 0 alone.
    No rank outlives its launcher, and none waits for ever for another: ranks that do not return within `grace` seconds
    after the end of `lead` are aborted. `LaunchError` off Linux, and with fewer ranks than the launcher announced.
    """
    if launcher() is None:
        with StopRequest() as stop:
            return lead(None, stop)
    refuse_ranks_off_linux()
    die_with_parent()
    if COMMAND_VARIABLE in os.environ:  # it passes these on by itself, unless it has to ignore them
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
    # Handlers come before MPI is initialised, for which all ranks wait: no request that rank 0 was told of can find a
    # rank without them.
    with StopRequest(finishes=own_rank() in {0, None}) as stop:
        # Open MPI's search for devices for one-sided messages, which nothing here uses, takes a second.
        os.environ.setdefault("OMPI_MCA_btl", "^ofi")
        from mpi4py import MPI  # noqa: PLC0415 - importing it starts MPI, which a serial run must not need
        from mpi4py.futures import MPICommExecutor  # noqa: PLC0415 - as above

        comm = MPI.COMM_WORLD
        names = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"]
        names += ["SLURM_STEP_NUM_TASKS"] * (launcher() == LAUNCHER_VARIABLES["PMIX_RANK"])
        announced = max(whole_number(name) or 1 for name in names)
        if comm.Get_size() < announced:  # each of them would compute the whole campaign
            raise LaunchError(
                f"{launcher()} announced {announced} ranks, but MPI has {comm.Get_size()}: the launcher was killed, or "
                "it belongs to another MPI library than mpi4py; use the launcher of that library"
            )
        if comm.Get_size() == 1:
            return lead(None, stop)
        processes = comm.allgather((platform.node(), os.getpid()))
        here = [process for host, process in processes if host == platform.node()]
        if comm.Get_rank() == 0:
            # A command passes requests of its user on as SIGUSR2. Without one a missing process tells.
            stop.has_lost = lambda: COMMAND_VARIABLE in os.environ or not all(map(exists, here))
            with MPICommExecutor(comm) as found:
                executor: Any = found
                return _lead_others(executor, comm, partial(lead, executor, stop), grace)
        try:
            if processes[0] == (platform.node(), here[0]):
                end_after(here[0], 10.0, EXIT_RESUMABLE)
            IS_INTERRUPTED.set(stop.hurry)
            with MPICommExecutor(comm):
                return EXIT_COMPLETE  # that of rank 0 counts
        except BaseException:
            # No sentence but a traceback: also of a program that listens to no logger, and before the abort.
            sys.stderr.write(f"rank {comm.Get_rank()}: {traceback.format_exc()}")
            comm.Abort(EXIT_ERROR)
            raise


def _lead_others(executor: Executor, comm: "MPI.Comm", lead: Callable[[], int], grace: float) -> int:
    """Work of rank 0; at its end the others get `grace` seconds to return."""
    code = EXIT_ERROR
    try:
        code = lead()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        timer = threading.Timer(grace, lambda: comm.Abort(code))
        timer.daemon = True
        timer.start()
        executor.shutdown(wait=True, cancel_futures=True)
        timer.cancel()
    return code
