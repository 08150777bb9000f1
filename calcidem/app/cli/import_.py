"""``calcidem import``: a database from an exported file, or a packing from the disks of another program."""

from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from calcidem.app.campaign.notices import printable
from calcidem.app.cli.arguments import number_parser, refuse_options

_RAISED_BY_DAMAGE = (RuntimeError, AttributeError, LookupError, TypeError, ValueError, ArithmeticError)
"""Exceptions of the NetCDF library and its callers for changed bytes of a file."""


def import_command(
    file: Annotated[
        Path,
        typer.Argument(
            help="NetCDF file of 'calcidem export', or disks: LAMMPS data or dump, YADE, extended XYZ, PFC, any table."
        ),
    ],
    database: Annotated[
        str | None,
        typer.Option("--db", metavar="DB", help="Database for the campaign; made if missing."),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="Disks: file to write for [packing].")] = None,
    unit: Annotated[str | None, typer.Option(help="Disks: unit of length, if the file has none.")] = None,
    columns: Annotated[str, typer.Option(help="Disks: names of the columns from the left: x,y,z,radius.")] = "",
    types: Annotated[list[str] | None, typer.Option("--type", help="Disks: only this type; may be repeated.")] = None,
    plane: Annotated[
        str | None, typer.Option(help="Disks: axes of the file that become x and y; by default those of their plane.")
    ] = None,
    walls: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            parser=number_parser(-1e12, 1e12, "is not a coordinate from -1e12 to 1e12"),
            metavar="LEFT RIGHT FLOOR LID",
            help="Disks: walls in the file's frame; by default the outermost disks touch them.",
        ),
    ] = None,
    timestep: Annotated[
        int | None, typer.Option(min=0, help="Disks: snapshot of a LAMMPS dump; by default the last.")
    ] = None,
) -> None:
    """Read an exported campaign into a database (--db), or disks of another program into a packing's file (--out).

    Cells that the database already has are kept. Changed files and other packings are refused. The format of disks is
    recognised by content. Left wall and floor become x = 0 and y = 0.
    """
    if (database is None) is (out is None):
        raise typer.BadParameter("give one of them: --db for an exported campaign, --out for disks of another program")
    if database is not None:
        of_disks = {"--unit": unit, "--columns": columns, "--type": types, "--walls": walls, "--timestep": timestep}
        refuse_options("leave it out: it is for disks, with --out", of_disks)
        _import_campaign(file, database)
    elif out is not None:
        from calcidem.app.disks.packing_import import import_packing

        names = tuple(name.strip() for name in columns.split(",")) if columns else ()
        imported = import_packing(
            file, out, unit=unit, columns=names, types=types or (), plane=plane, walls=walls, timestep=timestep
        )
        typer.echo(printable(imported))
        typer.echo(f'Wrote {out}\n\n[packing]\nfile = "{out}"\nwidth = {imported.width!r}')


def _import_campaign(file: Path, database: str) -> None:
    """Rebuild a campaign's database from its exported file."""
    from calcidem.app.campaign.stored_packing import stored_packing
    from calcidem.storage.errors import DamagedStoreError, InvalidRecordError
    from calcidem.storage.netcdf import import_netcdf
    from calcidem.storage.sql.engine import Address
    from calcidem.storage.sql.lease import replace_database
    from calcidem.storage.sql.store import Store

    path = Address.parse(database).path
    try:
        if path is None:  # opening a server's database creates tables, which would remain after a refusal
            with TemporaryDirectory() as folder, Store(Path(folder) / "trial.db") as trial:
                import_netcdf(file, trial, stored_packing)
        is_new = path is not None and (not path.exists() or (path.is_file() and path.stat().st_size == 0))
        place = replace_database(path) if path and is_new else nullcontext(database)
        with place as target, Store(target) as store:
            campaign = import_netcdf(file, store, stored_packing)
    except (*_RAISED_BY_DAMAGE, InvalidRecordError) as error:
        problem = f"{file} is damaged ({type(error).__name__}: {error})."
        raise DamagedStoreError(problem, "Export it again, and import it again; nothing was written.") from error
    cells = f"{len(campaign.seeds)} seeds, {len(campaign.contents)} contents"
    typer.echo(printable(f"Wrote {database}: campaign '{campaign.name}', {cells}"))
