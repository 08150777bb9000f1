"""``calcidem report``: one page about a campaign."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import CampaignName, Database


def report_command(
    database: Database,
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="Page to write or replace.")] = Path("report.html"),
    with_studies: Annotated[
        bool, typer.Option("--with-studies", help="Run the frequency and damping studies and include them.")
    ] = False,
    campaign: CampaignName = None,
) -> None:
    """Write one self-contained page: what was run, tables, figures, what failed, errors and run time."""
    from calcidem.app.report.page import write_report
    from calcidem.app.studies.frequency_and_damping import run_studies
    from calcidem.storage.files import refuse_to_replace

    refuse_to_replace(out)
    studies = run_studies(database, campaign_name=campaign) if with_studies else None
    typer.echo(f"Wrote {write_report(database, out, campaign_name=campaign, studies=studies)}")
