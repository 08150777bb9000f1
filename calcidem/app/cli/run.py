"""``calcidem run``: one campaign, in this process or on MPI ranks."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calcidem.app.campaign.notices import advise, printable, tell
from calcidem.app.cli.arguments import DEFAULT_CONFIGURATION, ConfigurationFile, number_parser, refuse_options
from calcidem.app.cli.terminal import IS_QUIET, IS_VERBOSE
from calcidem.sweep.progress import first_of, pluralize

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from concurrent.futures import Executor

    from calcidem.app.config.schema import Configuration

_parse_timeout = number_parser(1.0, 1e6, "is not a number of seconds from 1 to 1,000,000")

_Retried = StrEnum("_Retried", ["FAILED", "TIMED_OUT", "QUARANTINED"])


def run_command(
    configuration: ConfigurationFile = DEFAULT_CONFIGURATION,
    database: Annotated[
        str | None,
        typer.Option("--db", metavar="DB", help="SQLite file or database URL."),
    ] = None,
    output: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the results.")] = None,
    part: Annotated[
        str | None,
        typer.Option(metavar="K/N", help="Compute only part K of N of about equal effort."),
    ] = None,
    ranks: Annotated[
        int | None,
        typer.Option(
            min=0, max=100_000, help="Number of MPI ranks (rank 0 only coordinates); 0: one per core, plus one."
        ),
    ] = None,
    dask: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Compute on the workers of the Dask scheduler there.")
    ] = None,
    gpu: Annotated[
        bool,
        typer.Option(
            "--gpu",
            help="Propagate the waves on NVIDIA GPUs, with the same bits. This version was shown on numba's CUDA "
            "simulator only; it has not been run on a GPU.",
        ),
    ] = False,
    restarts: Annotated[
        int | None,
        typer.Option(min=0, metavar="K", help="With --ranks: start again up to K times (3) if a rank dies."),
    ] = None,
    start_timeout: Annotated[
        float,
        typer.Option(parser=_parse_timeout, metavar="SECONDS", help="With --ranks: time for the ranks to begin."),
    ] = 120.0,
    with_report: Annotated[bool, typer.Option("--report", help="Also write the report.")] = False,
    retry: Annotated[
        list[_Retried] | None,
        typer.Option(help="Also compute cells of this status again; may be repeated."),
    ] = None,
    check: Annotated[
        bool,
        typer.Option("--check", help="Compute nothing: check configuration and machine, estimate time and memory."),
    ] = False,
    serve: Annotated[bool, typer.Option("--serve", help="Show the run in the browser.")] = False,
    packing_only: Annotated[
        bool,
        typer.Option("--packing-only", help="Only make the packing, cache it and report on it."),
    ] = False,
) -> None:
    """Compute a campaign, or its missing cells: after a stop, the same command continues.

    Cells with the status failed, timed_out or quarantined (three runs died while computing them) are computed again
    only with --retry.
    """
    overrides = {
        "database": database,
        "output": None if output is None else str(output),
        "part": part,
        "gpu": gpu or None,
    }
    if part is not None and with_report:
        raise typer.BadParameter("a part is not a whole campaign; merge the parts first", param_hint="--report")
    if check or packing_only:
        refuse_options("leave it out: no cell is computed", {"--serve": serve, "--retry": retry})
        refuse_options("leave it or --check out: no packing is made", {"--packing-only": check and packing_only})
        loaded = _read_overridden(configuration, overrides)
        if check:
            from calcidem.app.campaign.preview import preview_lines

            typer.echo(printable("\n".join(preview_lines(loaded, ranks))))
        else:
            _make_packing_alone(loaded)
        return
    if dask is not None and ranks is not None:
        raise typer.BadParameter("leave --ranks out: the workers of the cluster compute", param_hint="--dask")
    if restarts is not None and (ranks is None or ranks == 1):
        raise typer.BadParameter(
            "give --ranks too, with 2 or more: only MPI ranks can be restarted", param_hint="--restarts"
        )
    with _live_page(configuration, overrides) if serve else nullcontext():
        from calcidem.sweep.ranks import run_on_ranks
        from calcidem.sweep.signals import StopRequest

        load = partial(_read_overridden, configuration, overrides, retry or ())
        if ranks is not None and ranks != 1:
            from calcidem.app.campaign.launch import Launch
            from calcidem.app.cli.run_view import TerminalView

            options = {"--db": database, "--output": output, "--part": part}
            arguments = ["run", str(configuration)]
            arguments += [word for name, value in options.items() if value is not None for word in (name, str(value))]
            arguments += [
                name
                for name, is_on in (("--gpu", gpu), ("--quiet", IS_QUIET.get()), ("--verbose", IS_VERBOSE.get()))
                if is_on
            ]
            launch = Launch(arguments, ranks, 3 if restarts is None else restarts, start_timeout)
            code = launch.run(load, TerminalView(with_report=with_report, cores_used=True))
        elif dask is not None:
            from calcidem.app.campaign.run import dask_executor, run_command_line
            from calcidem.app.cli.run_view import TerminalView

            view = TerminalView(with_report=with_report, cores_used=True)
            with dask_executor(dask) as executor, StopRequest() as stop:
                code = run_command_line(load, view, executor, stop)
        else:
            import calcidem.app.campaign.task  # noqa: F401 - what every rank needs, while rank 0 prepares

            def lead(executor: "Executor | None", stop: StopRequest) -> int:
                """Run the command on rank 0, which alone needs the database and a view."""
                from calcidem.app.campaign.run import run_command_line
                from calcidem.app.cli.run_view import TerminalView

                view = TerminalView(with_report=with_report, cores_used=False)
                return run_command_line(load, view, executor, stop)

            code = run_on_ranks(lead)
        raise typer.Exit(code)


def _make_packing_alone(configuration: "Configuration") -> None:
    """Make the packing alone, and report on it."""
    from calcidem.app.campaign.packing import provide_packing
    from calcidem.app.campaign.preview import wave_doubts
    from calcidem.app.cli.run_view import packing_lines
    from calcidem.app.config.checks import check_against_packing

    packing = provide_packing(configuration, None)
    typer.echo("\n".join(packing_lines(packing)))
    for warning in (*check_against_packing(configuration, packing), *wave_doubts(configuration, packing)):
        advise(f"{warning}.")


def _live_page(configuration: Path, overrides: Mapping[str, str | bool | None]) -> AbstractContextManager[None]:
    """Live page of the campaign while the command runs."""
    from calcidem.app.serve.address import page_beside_run
    from calcidem.sweep.environment import launcher

    if launcher() is not None:
        raise typer.BadParameter(
            f"leave it out under {launcher()}: 'calcidem serve DB --wait' beside the run does it", param_hint="--serve"
        )
    wanted = _read_overridden(configuration, overrides)
    return page_beside_run(wanted.database, wanted.campaign.name, tell)


def _read_overridden(
    configuration: Path, overrides: Mapping[str, str | bool | None], retry: Sequence[_Retried] = ()
) -> "Configuration":
    """Configuration, on rank 0 alone, so that the others do not import its reader. Cells to retry become pending."""
    from calcidem.app.config.reader import load_configuration

    loaded = load_configuration(configuration, overrides)
    beside = configuration.parent / loaded.database
    if not Path(loaded.database).exists() and beside.is_file():  # a URL of a server is neither
        place = f"{loaded.database} does not exist here, but {beside} is beside the configuration"
        tell(f"Note: {place}. To continue it, stop this run and give --db {beside}")
    if retry:
        from calcidem.app.campaign.run import retry_cells
        from calcidem.storage.records import CellStatus

        pending = retry_cells(loaded, [CellStatus(outcome.value) for outcome in retry])
        head = f"{pluralize(len(pending), 'cell')} to compute again:" if pending else "There is nothing to retry."
        tell("\n  ".join([head, *first_of(list(map(str, pending)))]))
    return loaded
