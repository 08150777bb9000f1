"""Move data: ``calcidem export``, ``import`` and ``merge``."""

from contextlib import nullcontext
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from calcidem.app.cli.options import (
    HIGHEST_SEED,
    CampaignName,
    Database,
    number_parser,
    percent_option,
    refuse_options,
    say,
)
from calcidem.storage.records import ARRAY_RECORDS
from calcidem.wording import first_of

_Array = StrEnum("_Array", list(ARRAY_RECORDS))  # type: ignore[misc]  # not literal


def export_command(
    database: Database,
    out: Annotated[Path, typer.Argument(metavar="OUT.nc|.vtu|.csv", help="File to write or replace.")],
    seed: Annotated[int | None, typer.Option(min=0, max=HIGHEST_SEED, help="Seed of the sample.")] = None,
    content: Annotated[float | None, percent_option("Its calcite content.")] = None,
    campaign: CampaignName = None,
    without: Annotated[
        list[_Array] | None,
        typer.Option(help="Leave out these arrays, most of the NetCDF file (repeatable)."),
    ] = None,
) -> None:
    """Write a campaign, or one sample of it, to a file.

    With --seed and --content: the sample with its contacts and cement for ParaView (.vtu), or the disks of its packing
    as CSV (x, y, radius in m).
    """
    if seed is None and content is None:
        from calcidem.storage.netcdf import export_netcdf
        from calcidem.storage.sql.store import read_campaign

        if out.suffix.lower() in {".vtu", ".csv"}:
            needed = ".vtu and .csv need --seed and --content"
            raise typer.BadParameter(f"'{out}' would be a NetCDF file; {needed}", param_hint="OUT")
        with read_campaign(database, campaign) as store:
            export_netcdf(store, out, without=without or ())
        say(f"Wrote {out} as NetCDF")
    else:
        from calcidem.app.campaign.opened import SUFFIXES, open_campaign

        if seed is None or content is None or without:
            raise typer.BadParameter("one sample has both --seed and --content, and nothing --without")
        if out.suffix.lower() not in SUFFIXES:
            raise typer.BadParameter(f"'{out}' ends with none of {', '.join(SUFFIXES)}", param_hint="OUT")
        with open_campaign(database, campaign) as opened:
            opened.sample(seed=seed, content=content).write(out)
        say(f"Wrote {out}")


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
    out: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="Disks: file to write.")] = None,
    unit: Annotated[str | None, typer.Option(help="Disks: unit of length, if the file has none.")] = None,
    columns: Annotated[str, typer.Option(help="Disks: names of the columns from the left: x,y,z,radius.")] = "",
    types: Annotated[list[str] | None, typer.Option("--type", help="Disks: only this type (repeatable).")] = None,
    plane: Annotated[
        str | None, typer.Option(help="Disks: axes that become x and y; by default those of their plane.")
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
        int | None, typer.Option(min=0, help="Disks: snapshot of a LAMMPS dump, by default the last.")
    ] = None,
) -> None:
    """Read an exported campaign into a database (--db), or disks of another program into a file (--out).

    Existing cells are kept. A changed configuration and other packings are refused; 'verify' finds changed numbers. The
    format of disks is recognised by content. Left wall and floor become x = 0 and y = 0.
    """
    if (database is None) is (out is None):
        raise typer.BadParameter("give one of them: --db for an exported campaign, --out for disks of another program")
    if database is not None:
        of_disks = {"--unit": unit, "--columns": columns, "--type": types, "--walls": walls, "--timestep": timestep}
        refuse_options("leave it out: it is for disks, with --out", of_disks | {"--plane": plane})
        _import_campaign(file, database)
    elif out is not None:
        from calcidem.app.disks import import_packing

        names = tuple(name.strip() for name in columns.split(",")) if columns else ()
        imported = import_packing(
            file, out, unit=unit, columns=names, types=types or (), plane=plane, walls=walls, timestep=timestep
        )
        say(imported)
        typer.echo(f'Wrote {out}\n\n[packing]\nfile = "{out}"\nwidth = {imported.width!r}')


def _import_campaign(file: Path, database: str) -> None:
    """Rebuild a campaign's database from its exported file."""
    from calcidem.app.campaign.packing import stored_packing
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
    say(f"Wrote {database}: campaign '{campaign.name}', {cells}")


def merge_command(
    sources: Annotated[list[str], typer.Argument(metavar="A.db B.db ...", help="Databases of the same campaign.")],
    out: Annotated[Path, typer.Option(metavar="C.db", help="SQLite file to write; new, or of the same campaign.")],
    prefer: Annotated[str | None, typer.Option(metavar="A.db", help="Database to take where values differ.")] = None,
    campaign: CampaignName = None,
) -> None:
    """Merge databases of one campaign, such as parts, into one.

    A done cell replaces any other. Different values of a done cell are refused unless --prefer chooses.
    """
    from calcidem.app.campaign.merge import merge_databases

    if prefer is not None and prefer not in sources:
        raise typer.BadParameter(f"{prefer} is none of {', '.join(sources)}.", param_hint="--prefer")
    merged = merge_databases(sources, out, prefer, campaign)
    planned = merged.settled + len(merged.missing)
    lines = [f"Wrote {out}: {merged.settled} of {planned} planned cells are finished"]
    lines += [f"  {number} cells from {source}" for source, number in zip(merged.sources, merged.taken, strict=True)]
    if merged.shared:
        lines.append(f"  {merged.shared} cells were in several databases with the same values")
    if merged.overruled:
        lines.append(f"  {merged.overruled} cells that went wrong in one database are done in another")
    if merged.conflicts:
        lines.append(f"  {len(merged.conflicts)} done cells had different values, resolved by --prefer:")
        lines += [f"    {line}" for line in first_of(merged.conflicts)]
    if merged.missing:
        lines += ["Missing:", *merged.missing_lines()]
        lines.append(f"'calcidem run CONFIG --db {out}' computes them.")
    say("\n".join(lines))
