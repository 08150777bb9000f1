"""The command `calcidem`."""

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

# The commands import what they need: numerical libraries take seconds to load, and `--help` should not.
# ruff: noqa: PLC0415

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")

DEFAULT_CONFIGURATION = Path("calcidem.toml")

app = typer.Typer(
    help="How much does the shear-wave velocity of sand vary because calcite cements its grains at random places?",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

ConfigurationFile = Annotated[Path, typer.Argument(metavar="[CONFIG]", help="TOML file of the campaign.")]
Database = Annotated[str, typer.Argument(metavar="DB", help="SQLite file or database URL.")]
CampaignName = Annotated[str | None, typer.Option("--campaign", help="Which one, if the database has several.")]


class Preset(StrEnum):
    """Example configurations that come with calcidem."""

    QUICK = "quick"
    PAPER = "paper"
    PAPER_LITERAL = "paper-literal"
    PAPER_LOCKED = "paper-locked"


class ArrayGroup(StrEnum):
    """Arrays of single cells in an exported file."""

    PATHS = "paths"
    SIGNALS = "signals"
    CEMENT = "cement"


@app.command()
def init(
    file: Annotated[Path, typer.Argument(metavar="[FILE]", help="File to write.")] = DEFAULT_CONFIGURATION,
    preset: Annotated[
        Preset,
        typer.Option(
            help="quick: 6 contents x 4 seeds; paper: all 17 x 116; paper-literal: Table 1 as printed; "
            "paper-locked: stress of preparation locked in, nothing calibrated."
        ),
    ] = Preset.QUICK,
) -> None:
    """Write an example configuration to start from."""
    from calcidem.app.config.presets import preset_text

    with file.open("x", encoding="utf-8") as target:
        target.write(preset_text(preset))
    typer.echo(f"Wrote {file}. Change it as you like, then: calcidem run {file}")


@app.command()
def run(
    configuration: ConfigurationFile = DEFAULT_CONFIGURATION,
    database: Annotated[
        str | None, typer.Option("--db", metavar="FILE", help="Database: file or URL, instead of the configuration's.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the results, instead of the configuration's.")
    ] = None,
    ranks: Annotated[
        int | None,
        typer.Option(min=0, help="Start so many MPI ranks, of which the first coordinates; 0: all cores and one more."),
    ] = None,
    restarts: Annotated[
        int,
        typer.Option(
            min=0, metavar="K", help="With --ranks: start again up to K times if ranks die and the rest cannot go on."
        ),
    ] = 0,
    with_report: Annotated[
        bool, typer.Option("--report", help="Write the report beside the NetCDF file, too.")
    ] = False,
) -> None:
    """Compute a campaign, or go on with it: the same command continues after a stop."""
    if ranks is not None and ranks != 1:
        from calcidem.app.campaign.launch import default_ranks, launch

        arguments = ["run", str(configuration)]
        arguments += ["--db", database] if database is not None else []
        arguments += ["--output", str(output)] if output is not None else []
        arguments += ["--report"] if with_report else []
        raise typer.Exit(launch(arguments, ranks or default_ranks(), restarts))
    if restarts:
        raise typer.BadParameter(
            "give --ranks too, of 2 or more: only ranks are started again", param_hint="--restarts"
        )
    from calcidem.app.cli.run_campaign import run_campaign

    overrides = {"database": database, "output": None if output is None else str(output)}
    run_campaign(configuration, overrides, with_report=with_report)


@app.command()
def packing(configuration: ConfigurationFile = DEFAULT_CONFIGURATION) -> None:
    """Make the packing of a campaign, keep it in the cache, and report on it."""
    from calcidem.app.campaign.packing import provide_packing
    from calcidem.app.cli.summary import packing_lines
    from calcidem.app.config.reader import load_configuration

    made = provide_packing(load_configuration(configuration), None, typer.echo)
    for line in packing_lines(made):
        typer.echo(line)


@app.command()
def export(
    database: Database,
    netcdf: Annotated[Path, typer.Argument(metavar="OUT.nc", help="NetCDF file to write or replace.")],
    campaign: CampaignName = None,
    without: Annotated[
        list[ArrayGroup] | None,
        typer.Option(help="Leave out these arrays of single cells, nearly all of the file; may be repeated."),
    ] = None,
) -> None:
    """Write a campaign into a NetCDF file."""
    from calcidem.storage.campaign import open_stored_campaign
    from calcidem.storage.netcdf.export import export_netcdf

    with open_stored_campaign(database, campaign) as opened:
        typer.echo(f"Wrote {export_netcdf(opened.store, opened.record, netcdf, without=without or ())}")


def main() -> None:
    """Entry point: run a command, and tell errors that are the user's to cure in one message."""
    for variable in THREADS:
        os.environ.setdefault(variable, "1")  # each rank has one core; it counts only before numpy is loaded
    from calcidem.app.cli import register

    register(app, sys.argv[1:])
    try:
        app()
    except Exception as error:
        from calcidem.app.cli.exit_codes import USER_ERRORS, exit_code_of

        if not isinstance(error, USER_ERRORS):
            raise
        sys.stderr.write(f"Error: {error}\n")
        sys.exit(exit_code_of(error))


if __name__ == "__main__":
    main()
