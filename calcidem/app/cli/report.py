"""``calcidem report``: one page about a campaign."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from calcidem.app.cli.arguments import CampaignName, Database, MeasuredFile


def report_command(
    database: Database,
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="Page to write or replace.")] = Path("report.html"),
    with_studies: Annotated[
        bool, typer.Option("--with-studies", help="Run the frequency and damping studies and include them.")
    ] = False,
    measured: MeasuredFile = None,
    campaign: CampaignName = None,
) -> None:
    """Write one self-contained page: what was run, tables, figures, what failed, errors and run time."""
    from calcidem.app.config.measured import read_targets
    from calcidem.app.report.page import write_report
    from calcidem.storage.files import refuse_to_replace

    refuse_to_replace(out)
    targets = read_targets(measured) if measured else ()
    studies = None
    if with_studies:
        from calcidem.app.studies.frequency_and_damping import run_studies

        studies = run_studies(database, campaign_name=campaign)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("Report")

        def watch(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        page = write_report(database, out, campaign_name=campaign, studies=studies, measured=targets, watch=watch)
    typer.echo(f"Wrote {page}")
