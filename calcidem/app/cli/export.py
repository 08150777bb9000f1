"""``calcidem export``: a campaign as a NetCDF file, or one of its samples for other programs."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import HIGHEST_SEED, CampaignName, Database, parse_percentage
from calcidem.storage.records import ARRAY_RECORDS

_Array = StrEnum("_Array", list(ARRAY_RECORDS))  # type: ignore[misc]  # not literal


def export_command(
    database: Database,
    out: Annotated[Path, typer.Argument(metavar="OUT.nc|.vtu|.csv", help="File to write or replace.")],
    seed: Annotated[int | None, typer.Option(min=0, max=HIGHEST_SEED, help="Seed of the sample.")] = None,
    content: Annotated[
        float | None, typer.Option(parser=parse_percentage, metavar="PERCENT", help="Its calcite content.")
    ] = None,
    campaign: CampaignName = None,
    without: Annotated[
        list[_Array] | None,
        typer.Option(help="Leave out these arrays, most of the NetCDF file; may be repeated."),
    ] = None,
) -> None:
    """Write a campaign to a NetCDF file, or one sample of it to a file.

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
    else:
        from calcidem.app.campaign.opened import SUFFIXES, open_campaign

        if seed is None or content is None or without:
            raise typer.BadParameter("one sample has both --seed and --content, and nothing --without")
        if out.suffix.lower() not in SUFFIXES:
            raise typer.BadParameter(f"'{out}' ends with none of {', '.join(SUFFIXES)}", param_hint="OUT")
        with open_campaign(database, campaign) as opened:
            opened.sample(seed=seed, content=content).write(out)
    typer.echo(f"Wrote {out}")
