"""One campaign on ranks or an executor: rank 0 prepares, hands out, stores and reports; the others compute."""

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import replace
from typing import NoReturn, Protocol

from calcidem.app.campaign.progress import ProgressDisplay, ProgressReporter, RunStage
from calcidem.app.campaign.run import CampaignRun, sweep_options
from calcidem.app.campaign.task import CellComputation, kernel_compilations
from calcidem.app.campaign.workers import describe_worker
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.packing import Packing
from calcidem.storage.errors import StoreUnavailableError
from calcidem.sweep.attempt import SweepInterrupted
from calcidem.sweep.processes import keep_freed_memory
from calcidem.sweep.run import run_sweep
from calcidem.sweep.session import Session
from calcidem.sweep.sweep_end import EXIT_RESUMABLE, LaunchError, SweepEnd

_CONNECT_TIMEOUT = 10.0
"""Seconds within which the scheduler has to answer."""

_TIME_TO_CLOSE = 3.0
"""Seconds to wait while it cancels running batches; a dead scheduler does not answer."""


class RunView(Protocol):
    """Messages and progress of a run on rank 0."""

    def say(self, text: str) -> None:
        """Write a sentence."""

    def display(self) -> ProgressDisplay:
        """Receiver of the progress."""

    def begin(self, work: CampaignRun) -> None:
        """Describe the coming computation."""

    def finish(self, work: CampaignRun, *, in_haste: bool) -> None:
        """Report the results and write files; at an urgent end only what takes no time."""

    def refuse(self, error: Exception) -> int:
        """Report an error that the user can remedy and return its exit code; raise any other."""


def run_on_ranks(
    load: Callable[[], Configuration],
    open_view: Callable[[], RunView],
    open_executor: Callable[[], AbstractContextManager[Executor | None]] = nullcontext,
) -> NoReturn:
    """Run a campaign, or its missing cells, and end with the exit code of the result.

    All ranks call this; only rank 0 loads the configuration and opens view and executor. With an executor its workers
    compute, and there are no other ranks.
    """
    keep_freed_memory()
    with Session() as session:
        if session.rank == 0:
            view = open_view()
            with view.display() as display, ExitStack() as stack:
                reporter = ProgressReporter(display)
                code, end = _lead(session, load, view, reporter, lambda: stack.enter_context(open_executor()))
        else:
            code, end = _follow(session)
        session.end(code, end)


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Connect to a scheduler; at the end cancel batches not yet begun.

    `LaunchError` if no scheduler answers at the address, or Dask is not installed.
    """
    try:
        from distributed import Client  # noqa: PLC0415 - an extra of the package
    except ImportError as error:
        raise LaunchError(f"--dask {address}: Dask is missing ({error}); pip install 'calcidem[dask]'") from error
    try:
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # a time-out is an OSError
        raise LaunchError(
            f"--dask {address}: no scheduler answers there ({error}); give the address that `dask scheduler` writes, "
            "like tcp://host:8786"
        ) from error
    try:
        yield client.get_executor(pure=False)
    finally:
        with suppress(Exception):  # any error is harmless: the outcomes are stored and the client is no longer needed
            client.close(timeout=_TIME_TO_CLOSE)


def _lead(
    session: Session,
    load: Callable[[], Configuration],
    view: RunView,
    reporter: ProgressReporter,
    open_executor: Callable[[], Executor | None],
) -> tuple[int, SweepEnd | None]:
    """Work of rank 0: prepare, have the cells computed, store them, and report; return exit code and end."""

    def end_in_haste() -> None:
        """End the packing if a signal requests an end at once."""
        if session.stop_request.hurry():
            raise SweepInterrupted

    workers = session.gather(describe_worker(session.rank))
    code, work, executor = 0, None, None
    try:
        _refuse_singletons(session.size)
        executor = open_executor()
        work = CampaignRun(load(), workers, view.say, end_in_haste, reporter.on_packing)
    except SweepInterrupted:
        request = session.stop_request.explanation
        view.say(f"{request}: ended before the packing was made; run it again to continue.")
        code = EXIT_RESUMABLE
    except Exception as error:  # noqa: BLE001 - the view raises again what is not the user's to cure
        code, session.obstacle = view.refuse(error), type(error).__name__
    session.broadcast(code)
    if work is None:
        return code, None
    with work:
        # The address of the database, which may have a password, is not broadcast.
        told = replace(work.configuration, run=replace(work.configuration.run, database=None))
        session.broadcast((told, work.packing, bool(work.batches)))
        view.begin(work)
        if work.batches:
            reporter.begin(RunStage.COMPILING)
            if executor is None:
                _compile_on_nodes(session, told, work.packing, reporter.on_compiling)
        try:
            end = work.compute(executor or session.comm, reporter, session.stop_request)
            reporter.begin(RunStage.WRITING)
            view.finish(work, in_haste=session.stop_request.hurry())
        except Exception as error:  # noqa: BLE001 - the view raises again what is not the user's to cure
            code, session.obstacle = view.refuse(error), type(error).__name__
            # After a restart the server has all stored data.
            return EXIT_RESUMABLE if isinstance(error, StoreUnavailableError) else code, work.end
        return end.exit_code, end


def _follow(session: Session) -> tuple[int, SweepEnd | None]:
    """Work of a worker; return exit code and end of the sweep."""
    session.gather(describe_worker(session.rank))
    if code := session.broadcast(0):
        return code, None
    told: tuple[Configuration, Packing, bool] = session.broadcast(None)
    configuration, packing, anything_to_do = told
    if anything_to_do:
        _compile_on_nodes(session, configuration, packing)
    cells = CellComputation(configuration, packing)
    end = run_sweep(session.comm, (), cells, None, options=sweep_options(configuration))
    return end.exit_code, end


def _compile_on_nodes(
    session: Session,
    configuration: Configuration,
    packing: Packing,
    tell: Callable[[str, str, int], object] = lambda *_: None,
) -> None:
    """Have each kernel compiled by one rank of each node, so that compilation counts for no cell's cost or time limit.

    The first rank of a node compiles the largest kernel, so the progress of rank 0 is that of all ranks.
    """
    session.share_on_node(kernel_compilations(configuration, packing, tell))


def _refuse_singletons(world_size: int, variables: Mapping[str, str] = os.environ) -> None:
    """Refuse to run as a single rank if several tasks were requested.

    `srun python` starts N independent programs, each of which would compute the whole campaign. `LaunchError` if Slurm
    counts several tasks, no mpirun started this process, and it is the only rank.
    """
    tasks = int(variables.get("SLURM_NTASKS", "1"))
    if tasks > 1 and world_size == 1 and "OMPI_COMM_WORLD_SIZE" not in variables:
        raise LaunchError(
            f"SLURM_NTASKS is {tasks}, but this process is the only MPI rank: `srun python` starts "
            "independent programs; use mpirun inside the job, or ask for one task"
        )
