"""``calcidem import``: a database from an exported file."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from calcidem.app.cli.terminal import printable

_RAISED_BY_DAMAGE = (RuntimeError, AttributeError, LookupError, TypeError, ValueError, ArithmeticError)
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
    from calcidem.app.campaign.stored_packing import identify_packing
    from calcidem.storage.files import write_atomically
    from calcidem.storage.netcdf.import_netcdf import import_netcdf
    from calcidem.storage.sql.engine import parse_address
    from calcidem.storage.sql.store import open_store

    path = parse_address(database).path
    with _told_as_damage(file):
        if path is None:  # a server's database would keep the tables that opening it makes, whatever is refused then
            with TemporaryDirectory() as folder, open_store(Path(folder) / "trial.db") as trial:
                import_netcdf(file, trial, identify_packing)
        is_new = path is not None and (not path.exists() or (path.is_file() and path.stat().st_size == 0))
        place = write_atomically(path) if path and is_new else nullcontext(database)
        with place as target, open_store(target) as store:
            campaign = import_netcdf(file, store, identify_packing)
    cells = f"{len(campaign.seeds)} seeds, {len(campaign.contents)} contents"
    typer.echo(printable(f"Wrote {database}: campaign '{campaign.name}', {cells}"))


@contextmanager
def _told_as_damage(file: Path) -> Iterator[None]:
    """Tell whatever is raised by bytes that are not those that were exported."""
    from calcidem.storage.errors import DamagedStoreError, InvalidRecordError

    try:
        yield
    except (*_RAISED_BY_DAMAGE, InvalidRecordError) as error:
        problem = f"{file} is damaged ({type(error).__name__}: {error})."
        raise DamagedStoreError(problem, "Export it again, and import it again; nothing was written.") from error
