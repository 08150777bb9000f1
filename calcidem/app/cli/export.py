"""``calcidem export``: a campaign as a NetCDF file."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import CampaignName, Database


def export_command(
    database: Database,
    netcdf: Annotated[Path, typer.Argument(metavar="OUT.nc", help="NetCDF file to write or replace.")],
    campaign: CampaignName = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="path|signal|cement",
            help="Leave out these arrays of single cells, nearly all of the file; may be repeated.",
        ),
    ] = None,
) -> None:
    """Write a campaign to a NetCDF file."""
    from calcidem.storage.netcdf.export import export_netcdf
    from calcidem.storage.records import ARRAY_RECORDS
    from calcidem.storage.sql.store import read_campaign

    for name in without or ():
        if name not in ARRAY_RECORDS:
            raise typer.BadParameter(f"{name!r} is none of {', '.join(ARRAY_RECORDS)}.", param_hint="--without")
    with read_campaign(database, campaign) as store:
        typer.echo(f"Wrote {export_netcdf(store, netcdf, without=without or ())}")
