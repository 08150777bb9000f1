"""Workers that compute batches: MPI ranks, those of `concurrent.futures`, or this process; facts about their launch.

A worker that is silent too long is given up. Among the ranks, rank 0 coordinates, all others compute what it submits.
What the operating system (Linux) does for processes is here, too.

An executor does not report the number or names of its workers. So each outcome names its worker, and more batches are
submitted than there are known workers. A new worker computes one of these and counts from its first outcome.

The computation, with the packing, is pickled once and sent with the first batches. A process keeps it by its hash. A
process that lacks it reports this, and the batch is submitted again with the computation.
"""

import contextlib
import ctypes
import os
import pickle
import platform
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, TypeAlias

from calcidem.ends import CellStatus
from calcidem.sweep.schedule import (
    EXIT_COMPLETE,
    EXIT_ERROR,
    EXIT_RESUMABLE,
    IS_INTERRUPTED,
    Batch,
    BatchOutcome,
    CellT,
    Compute,
    Failure,
    LaunchError,
    StopRequest,
    SweepError,
    SweepInterrupted,
    attempt,
)

if TYPE_CHECKING:
    from mpi4py import MPI

_Identity: TypeAlias = tuple[str, int, int, int | None]
"""Host, process, thread and MPI rank (None without MPI)."""


class ThisProcess(Executor):
    """Executor that computes in the calling thread: `submit` returns a finished future."""

    num_workers = 1

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":  # noqa: ANN401 - as in the base class
        """Call the function at once."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()
        try:
            future.set_result(function(*args, **kwargs))
        except SweepInterrupted as interrupt:
            future.set_exception(interrupt)
        return future


@dataclass(slots=True)
class _Flight(Generic[CellT]):
    """A batch in flight."""

    batch: Batch[CellT]
    patience: float
    """Seconds after its begin at which the worker counts as hanging."""
    is_first: bool
    """Whether no worker had answered when it was submitted, so that its worker may have to load its libraries."""
    begun: float | None = None
    """Time of its begin as far as the executor tells, s on the monotonic clock."""


class Workers(Generic[CellT]):
    """Workers of an executor, which stays open.

    A process that dies ends its executor (`ProcessPoolExecutor`). Then `exhausted` says why, and the sweep ends; the
    same command continues. Under MPI it ends the whole job: rank 0 gets a SIGTERM, see `StopRequest.has_lost`. Dask
    alone goes on: it tries a batch on four workers before it raises `KilledWorker`. The computation must be picklable
    unless `ThisProcess` is the executor.

    Parameters
    ----------
    time_limit
        Seconds for a batch. Its own check ends it there; a worker that does not answer for twice as long hangs.
    silence_floor
        Without a time limit a worker hangs after 20 times the slowest batch so far, scaled by cost, but not before
        these seconds. The first one has as long in addition to load its libraries and to compile, the others 10 times
        as long as the first took.

    Attributes
    ----------
    exhausted
        Reason why no more batches can be computed; else empty.
    last_dropped
        Time at which a worker was known to have dropped a batch because of a signal; None if none has.
    """

    def __init__(
        self, executor: Executor, compute: Compute[CellT, Any], time_limit: float | None, silence_floor: float
    ) -> None:
        self._executor, self._time_limit, self._silence_floor = executor, time_limit, silence_floor
        if isinstance(executor, ThisProcess):
            self._key, self._computation = "this process", b""
            _computations.clear()
            _computations[self._key] = compute
        else:
            self._computation = pickle.dumps(compute, pickle.HIGHEST_PROTOCOL)
            self._key = sha256(self._computation).hexdigest()
        self._in_flight: dict[Future[bytes], _Flight[CellT]] = {}
        self._done: SimpleQueue[Future[bytes]] = SimpleQueue()
        self._held: Batch[CellT] | None = None
        self._rank_of: dict[_Identity, int] = {}
        self._last_answer: dict[_Identity, float] = {}
        self._last_event = time.monotonic()  # a submission or an answer
        self._next_look = 0.0
        self._loading = silence_floor  # seconds that a worker may need in addition for its first batch
        self._slowest = 0.0  # seconds for a unit of cost
        self._longest = 0.0  # seconds of a batch
        self.exhausted = ""
        self.last_dropped: float | None = None

    @property
    def are_here(self) -> bool:
        """Whether this process computes, during `submit`."""
        return isinstance(self._executor, ThisProcess)

    @property
    def count(self) -> int:
        """Number of workers: as the executor tells, else those with an outcome in the last minute or so."""
        told = getattr(self._executor, "num_workers", None) or getattr(self._executor, "_max_workers", None)
        if told:
            return int(told)
        oldest = time.monotonic() - max(60.0, 10.0 * self._longest)
        return sum(answer > oldest for answer in self._last_answer.values())

    @property
    def running(self) -> int:
        """Number of batches submitted or held back."""
        return len(self._in_flight) + (self._held is not None)

    @property
    def wants_batch(self) -> bool:
        """Whether fewer batches are submitted than two for each worker and some for workers that may join."""
        if self.exhausted or self._held is not None:
            return False
        if self.are_here:
            return not self._in_flight
        if any(flight.batch.is_alone for flight in self._in_flight.values()):
            return False
        return len(self._in_flight) < 2 * (self.count or available_cores()) + 2

    def submit(self, batch: Batch[CellT]) -> None:
        """Submit a batch; one that has to be alone waits until no other is in flight."""
        if batch.is_alone and self._in_flight:
            self._held = batch
        else:
            self._submit(batch, with_computation=not self._rank_of)

    def begun(self) -> list[Batch[CellT]]:
        """Batches whose computation has begun since the last call, as far as the executor tells."""
        now, found = time.monotonic(), []
        for future, flight in self._in_flight.items():
            if flight.begun is None and (future.running() or future.done()):
                flight.begun = now
                found.append(flight.batch)
        return found

    def poll(self, wait: float) -> list[BatchOutcome[CellT, Any]]:
        """Receive outcomes; wait for the first one up to some seconds.

        `SweepError` if a worker cannot load the computation.
        """
        outcomes: list[BatchOutcome[CellT, Any]] = []
        while True:
            try:
                future = self._done.get(timeout=wait)
            except Empty:
                break
            wait = 0.0
            flight = self._in_flight.pop(future, None)
            if flight is None:
                continue
            try:
                outcome = self._answer(future.result(), flight)
            except SweepInterrupted:
                self.last_dropped = time.monotonic()
                continue
            except Exception as error:  # noqa: BLE001 - each executor has its own
                outcome = self._failure(error, flight)
                if outcome is None:
                    continue
            if outcome is None:
                self._submit(flight.batch, with_computation=True)
            else:
                outcomes.append(outcome)
        if time.monotonic() > self._next_look:
            self._find_hanging()
        if self._held is not None and not self._in_flight:
            batch, self._held = self._held, None
            self._submit(batch, with_computation=False)
        return outcomes

    def cancel(self) -> list[Batch[CellT]]:
        """Take batches back that have not begun."""
        taken = [] if self._held is None else [self._held]
        self._held = None
        return taken + [self._in_flight.pop(future).batch for future in list(self._in_flight) if future.cancel()]

    def _submit(self, batch: Batch[CellT], *, with_computation: bool) -> None:
        if self._time_limit is not None:
            patience = 2.0 * self._time_limit + 5.0  # a check may be late by seconds on a loaded machine
        elif self._slowest:
            patience = max(self._silence_floor, 20.0 * self._slowest * batch.cost)
        else:
            patience = 10.0 * self._silence_floor
        computation = self._computation if with_computation else None
        try:
            future = self._executor.submit(_compute_batch, self._key, computation, batch, self._time_limit)
        except Exception as error:  # noqa: BLE001 - each executor has its own
            self._end(f"the executor takes no more batches ({type(error).__name__}: {error})")
        else:
            self._in_flight[future] = _Flight(batch, patience, is_first=not self._last_answer)
            self._last_event = time.monotonic()
            future.add_done_callback(self._done.put)

    def _answer(self, answer: bytes, flight: _Flight[CellT]) -> BatchOutcome[CellT, Any] | None:
        """Outcome returned by a worker; None if the worker lacks the computation."""
        worker: _Identity
        worker, packed = pickle.loads(answer)  # noqa: S301 - written by a worker of the same program
        now = time.monotonic()
        if not self._last_answer and flight.begun is not None:
            self._loading = min(self._silence_floor, 10.0 * (now - flight.begun))
        self._last_answer[worker] = self._last_event = now
        rank = worker[3] if worker[3] is not None else len(self._rank_of) + (worker[1] != os.getpid())
        rank = self._rank_of.setdefault(worker, rank)
        if packed is None:
            return None
        seconds, results, failure = packed
        if results is not None:
            try:
                results = pickle.loads(results)  # noqa: S301 - as above
            except Exception as error:  # noqa: BLE001 - unpickling runs code of the result's class
                results, failure = None, Failure.from_exception(CellStatus.FAILED, error)
            else:
                self._slowest = max(self._slowest, seconds / flight.batch.cost)
                self._longest = max(self._longest, seconds)
        return BatchOutcome(flight.batch, seconds, results, failure, rank, worker[0])

    def _failure(self, error: Exception, flight: _Flight[CellT]) -> BatchOutcome[CellT, Any] | None:
        """Outcome of a batch that took down workers of Dask; None if the executor has ended.

        `SweepError` if the worker could not load the computation.
        """
        reason = f"{type(error).__name__}: {error}"
        if type(error).__name__ == "KilledWorker":  # an exception of Dask, which is not imported for this
            failure = Failure(CellStatus.QUARANTINED, f"took down its workers and is not tried again: {reason}")
            return BatchOutcome(flight.batch, 0.0, failure=failure, host="unknown host")
        if isinstance(error, BrokenExecutor | CancelledError | OSError):
            self._end(f"a worker was lost ({reason})")
            return None
        raise SweepError(
            f"A worker of the executor could not compute a batch ({reason}): install the same calcidem for all "
            "workers, and look at what they wrote"
        ) from error

    def _find_hanging(self) -> None:
        """End the sweep if a batch has had no outcome for too long, or if there are no workers."""
        now = time.monotonic()
        self._next_look = now + 0.5
        longest = max((flight.patience for flight in self._in_flight.values()), default=0.0)
        for flight in self._in_flight.values():
            allowed = flight.patience + (self._loading if flight.is_first else 0.0)
            if flight.begun is not None and now - flight.begun > allowed:
                cells = ", ".join(map(str, flight.batch.cells[:3]))
                cure = "if one needs longer, give time_limit"
                self._end(f"a worker has not answered within {allowed:.3g} s (cells {cells} ...); {cure}")
        if self._in_flight and now - self._last_event > longest + 10.0 * self._silence_floor:
            self._end(f"no worker has answered within {now - self._last_event:.3g} s")

    def _end(self, reason: str) -> None:
        self.exhausted = self.exhausted or reason


_computations: dict[str, Compute[Any, Any]] = {}
"""The computation of the latest sweep in this process, by its hash."""

_loading = threading.Lock()


def _compute_batch(key: str, computation: bytes | None, batch: Batch[Any], time_limit: float | None) -> bytes:
    """Compute a batch in a worker.

    Return the worker's identity and, if it has the computation, seconds, results and failure.
    """
    worker: _Identity = (platform.node(), os.getpid(), threading.get_ident(), own_rank())
    with _loading:
        if key not in _computations:
            if computation is None:
                return pickle.dumps((worker, None))
            _computations.clear()
            _computations[key] = pickle.loads(computation)  # noqa: S301 - written by the master of the same program
        compute = _computations[key]
    outcome = attempt(batch, compute, time_limit)
    results, failure = None, outcome.failure
    if failure is None:
        try:
            results = pickle.dumps(outcome.results, pickle.HIGHEST_PROTOCOL)
        except Exception as error:  # noqa: BLE001 - pickling runs code of the result's class
            failure = Failure.from_exception(CellStatus.FAILED, error)
    return pickle.dumps((worker, (outcome.seconds, results, failure)))


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
    daemon, which ends when it loses mpirun. Call this before MPI is initialised: if the launcher has ended by then, the
    initialisation fails and the rank ends. A caller that knows the process number of its parent gives it, since the
    parent may have ended before this call. `OSError` if the kernel refuses.
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

    A thread waits for this. `srun` does not end a job when one of its tasks is killed, as mpirun does.
    """
    try:
        descriptor = os.pidfd_open(process)
    except OSError:
        return  # before Linux 5.3, or it has just ended and MPI is being informed

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
    after the end of `lead` are aborted. `LaunchError` off Linux.
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
