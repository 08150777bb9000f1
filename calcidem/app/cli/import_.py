"""``calcidem import``: a database from an exported file."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.terminal import printable


def import_command(
    file: Annotated[Path, typer.Argument(help="NetCDF file that 'calcidem export' wrote.")],
    database: Annotated[
        str, typer.Option("--db", metavar="DB", help="SQLite file or database URL; created if it does not exist.")
    ],
) -> None:
    """Rebuild a campaign's database from its exported file; what a database already has is kept.

    A file that was changed, and one whose cells are on another packing than the database's, are refused.
    """
    from calcidem.app.campaign.packing import identify_packing
    from calcidem.storage.netcdf.import_netcdf import import_netcdf
    from calcidem.storage.sql.store import open_store

    with open_store(database) as store:
        campaign = import_netcdf(file, store, identify_packing)
    cells = f"{len(campaign.seeds)} seeds, {len(campaign.contents)} contents"
    typer.echo(printable(f"Wrote {database}: campaign '{campaign.name}', {cells}"))
