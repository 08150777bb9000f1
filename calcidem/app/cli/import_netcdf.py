"""``calcidem import``: a database from an exported file."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.storage.netcdf.import_netcdf import import_netcdf
from calcidem.storage.records import CampaignRecord
from calcidem.storage.sql.store import open_store


def import_file(
    file: Annotated[Path, typer.Argument(help="NetCDF file that 'calcidem export' wrote.")],
    db: Annotated[str, typer.Option(help="SQLite file or database URL; made if it isn't there.")],
) -> None:
    """Rebuild a campaign's database from its exported file; what a database has already stays."""
    campaign = imported(file, db)
    cells = f"{len(campaign.seeds)} seeds, {len(campaign.contents)} contents"
    typer.echo(f"Campaign '{campaign.name}' ({cells}) is in {db}.")


def imported(file: Path, database: str) -> CampaignRecord:
    """Import a file into a database and return the campaign as stored.

    Raises
    ------
    StoreError
        If the file isn't one of calcidem's, or the database has another campaign of that name.
    """
    with open_store(database) as store:
        return import_netcdf(file, store)
