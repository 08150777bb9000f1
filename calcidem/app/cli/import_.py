"""``calcidem import``: a database from an exported file."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.terminal import printable

_ERRORS_OF_DAMAGE = (RuntimeError, AttributeError, LookupError, TypeError, ValueError, ArithmeticError)
"""What the library for NetCDF, and who takes its answers, raise where bytes of a file are others."""


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
    from calcidem.storage.errors import DamagedStoreError
    from calcidem.storage.netcdf.import_netcdf import import_netcdf
    from calcidem.storage.sql.store import open_store

    with open_store(database) as store:
        try:
            campaign = import_netcdf(file, store, identify_packing)
        except _ERRORS_OF_DAMAGE as error:
            cure = f"Export it again, and import it again: what {database} has got of it by now stays."
            raise DamagedStoreError(f"{file} is damaged ({type(error).__name__}: {error}).", cure) from error
    cells = f"{len(campaign.seeds)} seeds, {len(campaign.contents)} contents"
    typer.echo(printable(f"Wrote {database}: campaign '{campaign.name}', {cells}"))
