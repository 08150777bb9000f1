"""`calcidem run`: one campaign on all ranks there are."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console

from calcidem.app.campaign.launch import TERMINAL_VARIABLE
from calcidem.app.campaign.run import CampaignRun, sweep_options
from calcidem.app.campaign.store_sink import HeartbeatProgress
from calcidem.app.campaign.task import cell_computation, compile_kernels
from calcidem.app.cli.exit_codes import USER_ERRORS, exit_code_of
from calcidem.app.cli.summary import packing_lines, velocity_table
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.packing import Packing
from calcidem.storage.netcdf.export import export_netcdf
from calcidem.storage.sql.engine import parse_address
from calcidem.storage.store import Selection
from calcidem.sweep import (
    EXIT_RESUMABLE,
    Session,
    StopRequest,
    SweepEnd,
    SweepInterrupted,
    progress_for,
    refuse_singletons,
    run_sweep,
)
from calcidem.sweep.environment import launcher

PLAIN_WIDTH = 110
"""Columns of tables in a log."""


@dataclass(frozen=True, slots=True)
class Orders:
    """What rank 0 tells all ranks before the cells are computed."""

    configuration: Configuration
    packing: Packing
    anything_to_do: bool


def orders_of(work: CampaignRun | None) -> Orders | None:
    """What rank 0 is to tell the others, from what it has prepared; None on the others."""
    return None if work is None else Orders(work.configuration, work.packing, bool(work.batches))


def make_console() -> Console:
    """Console for results.

    A rank cannot see by itself whether a terminal reads it, since launchers give it a pseudo-terminal.
    """
    if launcher() is None and sys.stdout.isatty():
        return Console(highlight=False)
    columns = int(os.environ.get(TERMINAL_VARIABLE, "0"))
    return Console(highlight=False, force_terminal=columns > 0, width=columns or PLAIN_WIDTH)


def run_campaign(path: Path, overrides: Mapping[str, Any], *, with_report: bool = False) -> NoReturn:
    """Run the campaign of a file, or what is left of it, and end with the exit code that says how it went.

    To be called on all ranks.
    """
    with Session() as session:
        console = make_console()
        work: CampaignRun | None = None
        code = 0
        if session.rank == 0:
            try:
                refuse_singletons(session.size)
                configuration = load_configuration(path, overrides)
                check = partial(end_in_haste, session.stop_request)
                work = CampaignRun(configuration, session.size, lambda text: say(console, text), check)
            except SweepInterrupted:
                say(
                    console,
                    f"{session.stop_request.explanation}: ended before the packing was made; run it again to go on.",
                )
                code = EXIT_RESUMABLE
            except USER_ERRORS as error:
                code = refusal(error)
        code = session.broadcast(code)
        if code:
            session.end(code)
        received = session.broadcast(orders_of(work))
        if work is None:
            worker_end = compute(session, received)
            session.end(worker_end.exit_code, worker_end)
        with work:
            code = lead(session, received, work, console, with_report)
        session.end(code, work.end)


def end_in_haste(stop_request: StopRequest) -> None:
    """End the making of the packing if a signal asks for an end at once.

    Raises
    ------
    SweepInterrupted
        To be taken for the end of a run that goes on with the same command.
    """
    if stop_request.hurry():
        raise SweepInterrupted


def compute(session: Session, orders: Orders) -> SweepEnd:
    """What a worker does."""
    prepare(session, orders)
    cells = cell_computation(orders.configuration, orders.packing)
    return run_sweep(session.comm, (), cells, None, options=sweep_options(orders.configuration))


def prepare(session: Session, orders: Orders) -> None:
    """Have the kernels compiled once on each node; alone, the first cells do it."""
    if orders.anything_to_do and session.size > 1:
        session.once_per_node(lambda: compile_kernels(orders.configuration, orders.packing))


def lead(session: Session, orders: Orders, work: CampaignRun, console: Console, with_report: bool) -> int:
    """What rank 0 does: have the cells computed, store them, and report; returns the exit code."""
    for line in packing_lines(work.packing):
        say(console, line)
    prepare(session, orders)
    try:
        work.end = run_sweep(
            session.comm,
            work.batches,
            cell_computation(orders.configuration, work.packing, work.lease_keeper),
            work.sink,
            options=sweep_options(orders.configuration),
            progress=HeartbeatProgress(progress_for(console), work.lease_keeper),
            stop_request=session.stop_request,
        )
        report(work, console, in_haste=session.stop_request.hurry())
        if with_report and work.end.exit_code == 0:
            from calcidem.app.report import write_report  # noqa: PLC0415 - drawing libraries take seconds to load

            page = write_report(work.configuration.database, work.configuration.netcdf.with_suffix(".html").absolute())
            say(console, f"Report:   {page}")
    except USER_ERRORS as error:
        return refusal(error)
    return work.end.exit_code


def report(work: CampaignRun, console: Console, in_haste: bool) -> None:
    """Tell the velocities and where everything is; in haste the export is left out."""
    configuration = work.configuration
    plan = configuration.campaign
    console.print(velocity_table(work.store, Selection(seeds=plan.seed_numbers, contents=plan.contents)))
    path = parse_address(configuration.database).path
    say(console, f"Database: {configuration.database if path is None else path.absolute()}")
    if in_haste:
        say(console, f"NetCDF:   not written, to end quickly; calcidem export {configuration.database} OUT.nc does it")
    else:
        exported = export_netcdf(work.store, work.record, configuration.netcdf)
        say(console, f"NetCDF:   {exported}")


def refusal(error: BaseException) -> int:
    """Tell an error of the user and return the exit code it means."""
    sys.stderr.write(f"Error: {error}\n")
    return exit_code_of(error)


def say(console: Console, text: str) -> None:
    """Write a line as it is."""
    console.print(text, markup=False, soft_wrap=True)
