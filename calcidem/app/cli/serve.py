"""``calcidem serve``: campaigns in the browser, during and after their runs."""

import os
import sys
from typing import Annotated

import typer

from calcidem.app.campaign.notices import printable


def serve_command(
    databases: Annotated[list[str], typer.Argument(metavar="DB...", help="SQLite files or database URLs.")],
    campaign: Annotated[
        list[str] | None,
        typer.Option("--campaign", metavar="NAME", help="Campaigns of a database that has several; may be repeated."),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 for any that is free.")] = 0,
    host: Annotated[str, typer.Option(metavar="HOST", help="Address to listen on.")] = "127.0.0.1",
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait for databases and campaigns that do not exist yet.")
    ] = False,
) -> None:
    """Show campaigns side by side in the browser, also while they run.

    The printed address has a secret token. Ctrl-C ends the server. Databases are only read.
    """
    from calcidem.app.serve.address import PageAddress

    address = PageAddress.take(host, port)
    from calcidem.app.serve.server import LivePage

    if campaign and len(databases) > 1:
        raise typer.BadParameter("give one database with it", param_hint="--campaign")
    names: list[str | None] = list(campaign) if campaign else [None]
    wanted = [(database, name) for database in databases for name in names]

    def tell() -> None:
        typer.echo(printable(f"Live page: {address.url}"))
        sys.stdout.flush()

    LivePage(wanted, address).serve(tell, wait=wait)
    sys.stdout.flush()
    os._exit(0)  # without waiting for a thread that reads a slow or locked database
