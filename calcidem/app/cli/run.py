"""``calcidem run``: one campaign, in this process or on MPI ranks."""

from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calcidem.app.cli.arguments import DEFAULT_CONFIGURATION, ConfigurationFile, parse_timeout
from calcidem.app.cli.terminal import printable

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.cli.run_view import TerminalView
    from calcidem.app.config.schema import Configuration


def run_command(
    configuration: ConfigurationFile = DEFAULT_CONFIGURATION,
    database: Annotated[
        str | None,
        typer.Option("--db", metavar="DB", help="SQLite file or database URL, instead of the configuration's."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the results, instead of the configuration's.")
    ] = None,
    part: Annotated[
        str | None,
        typer.Option(
            metavar="K/N", help="Compute only part K of N of about equal effort, into a database to merge with theirs."
        ),
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
    restarts: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="K", help="With --ranks: restart up to K times (3) if ranks die and the others cannot go on."
        ),
    ] = None,
    start_timeout: Annotated[
        float,
        typer.Option(
            parser=parse_timeout, metavar="SECONDS", help="With --ranks: time for all ranks to find one another."
        ),
    ] = 120.0,
    silence_timeout: Annotated[
        float,
        typer.Option(
            parser=parse_timeout, metavar="SECONDS", help="With --ranks: silence after which a host is given up."
        ),
    ] = 60.0,
    with_report: Annotated[
        bool, typer.Option("--report", help="Also write the report, next to the NetCDF file.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Compute nothing: check the configuration and say what would be computed.")
    ] = False,
    serve: Annotated[
        bool, typer.Option("--serve", help="Show the run in the browser while it lasts; the address is printed.")
    ] = False,
    packing_only: Annotated[
        bool,
        typer.Option(
            "--packing-only", help="Compute no cell: make the packing, keep it in the cache and report on it."
        ),
    ] = False,
) -> None:
    """Compute a campaign, or what is left of it: after a stop, the same command continues."""
    overrides = {"database": database, "output": None if output is None else str(output), "part": part}
    if part is not None and with_report:
        raise typer.BadParameter("a part is no whole campaign; merge the parts first", param_hint="--report")
    if serve and (check or packing_only):
        raise typer.BadParameter("leave it out: no cell is computed", param_hint="--serve")
    if packing_only:
        from calcidem.app.campaign.packing import provide_packing
        from calcidem.app.cli.tables import packing_lines
        from calcidem.app.config.checks import check_against_packing, packing_warnings
        from calcidem.app.config.reader import load_configuration

        loaded = load_configuration(configuration, overrides)
        packing = provide_packing(loaded, None, typer.echo)
        typer.echo("\n".join(packing_lines(packing)))
        check_against_packing(loaded, packing)
        for warning in packing_warnings(loaded, packing):
            typer.echo(f"Warning: {warning}.")
        return
    if check:
        from calcidem.app.campaign.preview import preview_lines
        from calcidem.app.config.reader import load_configuration

        lines = list(preview_lines(load_configuration(configuration, overrides)))  # or nothing, if something is wrong
        typer.echo(printable("\n".join(lines)))
        return
    if dask is not None and ranks is not None:
        raise typer.BadParameter("leave --ranks out: the workers of the cluster compute", param_hint="--dask")
    if restarts is not None and (ranks is None or ranks == 1):
        raise typer.BadParameter(
            "give --ranks too, with 2 or more: only MPI ranks can be restarted", param_hint="--restarts"
        )
    with _live_page(configuration, overrides) if serve else nullcontext():
        if ranks is not None and ranks != 1:
            from calcidem.app.campaign.launch import Launch, default_ranks

            arguments = ["run", str(configuration)]
            arguments += ["--db", database] if database is not None else []
            arguments += ["--output", str(output)] if output is not None else []
            arguments += ["--part", part] if part is not None else []
            arguments += ["--report"] if with_report else []
            launch = Launch(
                arguments, ranks or default_ranks(), 3 if restarts is None else restarts, start_timeout, silence_timeout
            )
            raise typer.Exit(launch.run())
        from calcidem.app.campaign.dask_cluster import dask_executor
        from calcidem.app.campaign.ranks import run_on_ranks

        run_on_ranks(
            partial(_read_overridden, configuration, overrides),
            partial(_open_view, with_report=with_report, one_process=dask is None),
            nullcontext if dask is None else partial(dask_executor, dask),
        )


def _live_page(configuration: Path, overrides: dict[str, str | None]) -> AbstractContextManager[None]:
    """The live page of the campaign, for as long as the command runs."""
    from calcidem.app.serve.beside_run import page_beside_run
    from calcidem.sweep.environment import launcher

    if launcher() is not None:
        raise typer.BadParameter(
            f"leave it out under {launcher()}: 'calcidem serve DB --wait' beside the run does it", param_hint="--serve"
        )
    wanted = _read_overridden(configuration, overrides)
    return page_beside_run(wanted.database, wanted.campaign.name, lambda text: typer.echo(printable(text)))


def _read_overridden(configuration: Path, overrides: dict[str, str | None]) -> "Configuration":
    """The configuration, on rank 0 alone; the others do not wait for what reads it."""
    from calcidem.app.config.reader import load_configuration

    return load_configuration(configuration, overrides)


def _open_view(*, with_report: bool, one_process: bool) -> "TerminalView":
    """What a person reads, on rank 0 alone."""
    from calcidem.app.cli.run_view import TerminalView

    return TerminalView(with_report=with_report, one_process=one_process)
