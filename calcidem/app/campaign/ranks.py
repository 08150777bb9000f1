"""One campaign on all the ranks there are: rank 0 prepares, hands out, stores and tells, the others compute."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NoReturn, Protocol

from calcidem.app.campaign.run import CampaignRun, sweep_options
from calcidem.app.campaign.store_sink import HeartbeatProgress
from calcidem.app.campaign.task import cell_computation, compile_kernels
from calcidem.app.campaign.workers import describe_worker
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.packing import Packing
from calcidem.sweep import (
    EXIT_RESUMABLE,
    Progress,
    Session,
    StopRequest,
    SweepEnd,
    SweepInterrupted,
    refuse_singletons,
    run_sweep,
)


class RunView(Protocol):
    """What rank 0 tells about a run."""

    def say(self, text: str) -> None:
        """Tell a sentence."""

    def progress(self) -> Progress:
        """What follows the cells while they are computed."""

    def begin(self, work: CampaignRun) -> None:
        """Tell what is about to be computed."""

    def finish(self, work: CampaignRun, *, in_haste: bool) -> None:
        """Tell what came out, and write it; in haste only what takes no time."""

    def refuse(self, error: Exception) -> int:
        """Tell an error that is the user's to cure and give its exit code; raise any other."""


@dataclass(frozen=True, slots=True)
class _Orders:
    """What rank 0 tells all ranks before the cells are computed."""

    configuration: Configuration
    packing: Packing
    anything_to_do: bool


def run_on_ranks(load: Callable[[], Configuration], view: RunView) -> NoReturn:
    """Run a campaign, or what is left of it, and end with the exit code that says how it went.

    To be called on all ranks; the configuration is loaded on rank 0 only.
    """
    with Session() as session:
        work: CampaignRun | None = None
        code = 0
        workers = session.gather(describe_worker(session.rank))
        if session.rank == 0:
            try:
                refuse_singletons(session.size)
                work = CampaignRun(load(), workers, view.say, partial(_end_in_haste, session.stop_request))
            except SweepInterrupted:
                request = session.stop_request.explanation
                view.say(f"{request}: ended before the packing was made; run it again to go on.")
                code = EXIT_RESUMABLE
            except Exception as error:  # noqa: BLE001 - the view raises again what is not the user's to cure
                code = view.refuse(error)
        code = session.broadcast(code)
        if code:
            session.end(code)
        orders = session.broadcast(
            None if work is None else _Orders(work.configuration, work.packing, bool(work.batches))
        )
        if work is None:
            worker_end = _follow(session, orders)
            session.end(worker_end.exit_code, worker_end)
        with work:
            code = _lead(session, orders, work, view)
        session.end(code, work.end)


def _end_in_haste(stop_request: StopRequest) -> None:
    """End the making of the packing if a signal asks for an end at once.

    Raises
    ------
    SweepInterrupted
        To be taken for the end of a run that goes on with the same command.
    """
    if stop_request.hurry():
        raise SweepInterrupted


def _compile_on_nodes(session: Session, orders: _Orders) -> None:
    """Have the kernels compiled once on each node, so that no cell's cost or time limit has it."""
    if orders.anything_to_do:
        session.once_per_node(lambda: compile_kernels(orders.configuration, orders.packing))


def _follow(session: Session, orders: _Orders) -> SweepEnd:
    """What a worker does."""
    _compile_on_nodes(session, orders)
    cells = cell_computation(orders.configuration, orders.packing)
    return run_sweep(session.comm, (), cells, None, options=sweep_options(orders.configuration))


def _lead(session: Session, orders: _Orders, work: CampaignRun, view: RunView) -> int:
    """What rank 0 does: have the cells computed, store them, and report; returns the exit code."""
    view.begin(work)
    _compile_on_nodes(session, orders)
    try:
        work.end = run_sweep(
            session.comm,
            work.batches,
            cell_computation(orders.configuration, work.packing, work.lease_keeper),
            work.sink,
            options=sweep_options(orders.configuration),
            progress=HeartbeatProgress(view.progress(), work.lease_keeper),
            stop_request=session.stop_request,
        )
        view.finish(work, in_haste=session.stop_request.hurry())
    except Exception as error:  # noqa: BLE001 - the view raises again what is not the user's to cure
        return view.refuse(error)
    return work.end.exit_code
