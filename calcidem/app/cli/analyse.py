"""``calcidem analyse``: a campaign as a folder of figures, tables and numbers."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import CampaignName, Database, MeasuredFile
from calcidem.app.cli.terminal import printable


def analyse_command(
    database: Database,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files; created if it is missing.")] = Path(
        "analysis"
    ),
    measured: MeasuredFile = None,
    campaign: CampaignName = None,
) -> None:
    """Write all figures (PNG, SVG, PDF), tables (CSV) and numbers (NetCDF) of a campaign to a folder."""
    from calcidem.app.config.measured import read_targets
    from calcidem.app.report.folder import analyse

    targets = read_targets(measured) if measured else ()
    missing = analyse(database, out, campaign_name=campaign, measured=targets)
    for name, reason in missing.items():
        typer.echo(printable(f"Left out {name}: {reason}"))
    typer.echo(f"Wrote {len(list(out.iterdir()))} files to {out}")
