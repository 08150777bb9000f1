"""MPI ranks as an executor: rank 0 coordinates, all others compute what it submits."""

import os
import platform
import sys
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from typing import TYPE_CHECKING, Any

from calcidem.sweep.attempt import IS_INTERRUPTED
from calcidem.sweep.environment import COMMAND_VARIABLE, launcher, own_rank, refuse_ranks_off_linux
from calcidem.sweep.processes import die_with_parent, end_after, exists
from calcidem.sweep.signals import StopRequest
from calcidem.sweep.sweep_end import EXIT_COMPLETE, EXIT_ERROR, EXIT_RESUMABLE

if TYPE_CHECKING:
    from mpi4py import MPI


def run_on_ranks(lead: Callable[[Executor | None, StopRequest], int], grace: float = 3.0) -> int:
    """Call `lead` with an executor of all other ranks and the requests to stop; return the exit code of this process.

    Without an MPI launcher, or with one rank, there is no executor. All ranks call this; `lead` runs on rank 0 alone.
    No rank outlives its launcher, and none waits for ever for another: ranks that do not return within `grace` seconds
    after the end of `lead` are aborted. `LaunchError` off Linux.
    """
    if launcher() is None:
        with StopRequest() as stop:
            return lead(None, stop)
    refuse_ranks_off_linux()
    die_with_parent()
    # Handlers come before MPI is initialised, for which all ranks wait: no request that rank 0 was told of can find a
    # rank without them.
    with StopRequest(finishes=own_rank() in {0, None}) as stop:
        # Open MPI's search for devices for one-sided messages, which nothing here uses, takes a second.
        os.environ.setdefault("OMPI_MCA_btl", "^ofi")
        from mpi4py import MPI  # noqa: PLC0415 - importing it starts MPI, which a serial run must not need
        from mpi4py.futures import MPICommExecutor  # noqa: PLC0415 - as above

        comm = MPI.COMM_WORLD
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
