"""Begin, common preparation and end of a program that may be one of many ranks."""

import logging
import os
import select
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, NoReturn, Self, TypeVar

from calcidem.launch.channel import command_listens, tell_command
from calcidem.launch.starter import die_with_parent
from calcidem.sweep.backoff import wait_until
from calcidem.sweep.environment import NO_DEVICE_SEARCH, fault_tolerance_enabled, launcher, refuse_ranks_off_linux
from calcidem.sweep.processes import ProcessIdentity
from calcidem.sweep.signals import StopRequest, leave_signals_to_master
from calcidem.sweep.sweep_end import EXIT_COMPLETE, EXIT_ERROR, EXIT_RESUMABLE, MasterLostError, SweepEnd

if TYPE_CHECKING:
    from mpi4py import MPI  # importing it starts MPI, which a serial run must not need

    from calcidem.sweep.protocol import Ranks

ValueT = TypeVar("ValueT")

_MASTER_GONE_GRACE = 10.0
"""Seconds after the end of rank 0 in which the others on its machine have to end by themselves."""

_RELEASE_LIMIT = 2.0
"""Seconds in which the others have to receive the end, before rank 0 ends."""


class Session:
    """Context manager of a program that runs alone or as one of many ranks.

    MPI is loaded only if an MPI launcher started the process. No rank outlives its launcher. An exception that leaves
    the block ends all ranks, so that none waits for another for ever. Signals are recorded from the start
    (`stop_request`). A parallel program ends inside the block, with `end` or `abort`.

    Attributes
    ----------
    comm
        Communicator of all ranks, or None if the program runs alone.
    rank, size
        Number of this rank, from 0, and of all ranks.
    stop_request
        Signals that request a stop, recorded on rank 0; the other ranks ignore them.
    obstacle
        One word for an obstacle that ends the program and would also end a restart; empty without one.
    """

    def __init__(self) -> None:
        self.comm: MPI.Comm | None = None
        self._ranks: Ranks | None = None
        self.rank = 0
        self.size = 1
        self.stop_request = StopRequest(end_at_once=self._abort_mpi)
        self.obstacle = ""
        self._ending = False

    def __enter__(self) -> Self:
        """Join the other ranks if this process was launched as one of them.

        `LaunchError` if so, but not on Linux.
        """
        if launcher() is not None:
            refuse_ranks_off_linux()
            die_with_parent()
            tell_command("loaded")
            os.environ.update(NO_DEVICE_SEARCH | os.environ)
            import mpi4py  # noqa: PLC0415 - a serial run must not need an MPI library

            mpi4py.rc.thread_level = "funneled"  # only the main thread calls MPI
            from mpi4py import MPI  # noqa: PLC0415 - as above

            from calcidem.sweep.protocol import Ranks  # noqa: PLC0415 - as above

            self.comm = MPI.COMM_WORLD
            self._ranks = Ranks(self.comm)
            self.rank, self.size = self.comm.Get_rank(), self.comm.Get_size()
        if self.rank == 0:
            self.stop_request.__enter__()
        else:
            leave_signals_to_master()
        if self.size > 1:
            master = self.broadcast(ProcessIdentity.of_this_process())
            if self.rank != 0:
                _end_after(master, _MASTER_GONE_GRACE, EXIT_RESUMABLE)
        tell_command("joined")
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        """End all ranks if an exception leaves the block on one of many; a single process continues."""
        if self.rank == 0:
            self.stop_request.__exit__()
        # An exit without `end` would leave the other ranks waiting, as any exception would.
        if self.comm is None or self.size == 1 or (self._ending and isinstance(error, SystemExit)):
            return
        if error is None:
            self.end(EXIT_COMPLETE)
        from mpi4py import MPI  # noqa: PLC0415 - a serial run must not need an MPI library

        if isinstance(error, MasterLostError | MPI.Exception) and fault_tolerance_enabled():
            # Every rank detects this itself; several ranks that abort at once can block mpirun for ever.
            sys.stderr.write(f"rank {self.rank}: another rank is lost ({error}); the same command continues\n")
            self._flush(EXIT_RESUMABLE)
            os._exit(EXIT_RESUMABLE)
        try:
            told = (
                "no memory is left\n" if isinstance(error, MemoryError) else "".join(traceback.format_exception(error))
            )
            sys.stderr.write(f"rank {self.rank}: {told}")
        finally:  # ends the others even if there is no memory for the message
            self.abort(EXIT_ERROR)

    def broadcast(self, value: ValueT | None) -> ValueT:
        """Return on all ranks the value of rank 0; waiting uses no core."""
        if self._ranks is None:
            if value is None:
                raise ValueError("value is None on rank 0: give the value to broadcast")
            return value
        return self._ranks.broadcast(value)

    def gather(self, value: ValueT) -> list[ValueT]:
        """Return on rank 0 the values of all ranks, in the order of the ranks; on the others none."""
        if self._ranks is None:
            return [value]
        return self._ranks.gather(value)

    def share_on_node(self, actions: Sequence[Callable[[], object]]) -> None:
        """Call each action on one rank of each node, for instance to compile; return once all have finished."""
        if self._ranks is None:
            for action in actions:
                action()
            return
        self._ranks.share_on_node(actions)

    def end(self, exit_code: int, sweep_end: SweepEnd | None = None) -> NoReturn:
        """End this rank regularly. Every rank calls this, rank 0 after its work and with files closed.

        The exit code of rank 0 counts. Ranks that did not answer at the end of the last sweep are not awaited.
        """
        self._flush(exit_code)
        self._ending = True
        if self._ranks is not None and self.size > 1:
            # If a rank ends early, mpirun ends the others: always without ULFM, sometimes with it.
            deaf = frozenset() if sweep_end is None else sweep_end.unresponsive_ranks
            if deaf and not (fault_tolerance_enabled() and command_listens()):
                self._abort_mpi(exit_code)  # with ULFM a command ends the remaining ranks with fewer messages
            if self.rank == 0:
                self._ranks.release(set(range(1, self.size)) - deaf, _RELEASE_LIMIT)
            else:
                self._ranks.wait_for_release()
                exit_code = EXIT_COMPLETE
            if fault_tolerance_enabled():
                os._exit(exit_code)  # MPI_Finalize would wait for lost ranks for ever
        sys.exit(exit_code)

    def abort(self, exit_code: int) -> NoReturn:
        """End all ranks at once, after an error on one of them."""
        with suppress(MemoryError):  # ends the others even without a message
            self._flush(exit_code)
        self._abort_mpi(exit_code)
        os._exit(exit_code)

    def _flush(self, exit_code: int) -> None:
        """Flush all output, and send the exit code to the command.

        mpirun's exit code is unreliable: with ULFM it is 0 even if all ranks were killed, and after a SIGTERM always 1.
        """
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        if self.rank == 0:
            tell_command(f"exit {exit_code} {self.stop_request.reason or self.obstacle}")

    def _abort_mpi(self, exit_code: int = EXIT_RESUMABLE) -> None:
        """End the other ranks, if any remain."""
        if self.comm is None or self.size == 1:
            return
        if fault_tolerance_enabled() and self._others_have_ended():
            return  # after an Abort by the last rank mpirun would always return 0
        self.comm.Abort(exit_code)

    def _others_have_ended(self) -> bool:
        """Return whether all other ranks end within half a second."""
        comm, ranks = self.comm, self._ranks
        if comm is None or ranks is None:
            return False

        def all_failed() -> bool:
            comm.Iprobe(self.rank)  # MPI detects failures only during calls
            return len(ranks.failed()) == self.size - 1

        return wait_until(all_failed, limit=0.5)


def _end_after(other: ProcessIdentity, grace: float, exit_code: int) -> None:
    """End this process some seconds after the end of another one on the same machine, unless it ends by itself.

    A thread waits for this. It covers ends that MPI does not detect as a failure, such as an `exit(1)` outside of its
    control: otherwise a rank would wait for a message of that process for ever.
    """
    if other.machine != ProcessIdentity.of_this_process().machine:
        return
    try:
        descriptor = os.pidfd_open(other.process)
    except OSError:
        return  # before Linux 5.3, or it has just ended and MPI is being informed

    def wait_and_end() -> None:
        select.select([descriptor], [], [])
        time.sleep(grace)
        os._exit(exit_code)

    threading.Thread(target=wait_and_end, name="watch-master", daemon=True).start()
