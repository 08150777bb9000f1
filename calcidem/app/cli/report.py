"""``calcidem report``: one page about a campaign."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.campaign.notices import tell
from calcidem.app.cli.arguments import CampaignName, Database
from calcidem.app.cli.terminal import progress_bar


def report_command(
    database: Database,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Page to write or replace; DB.html beside the database if not given."),
    ] = None,
    with_studies: Annotated[
        bool, typer.Option("--with-studies", help="Run the frequency and damping studies and include them.")
    ] = False,
    files: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for all figures (PNG, SVG, PDF), tables (CSV) and numbers (NetCDF)."),
    ] = None,
    measured: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Laboratory velocities to compare, a row for each specimen or mean: content, Vs, and sd, samples, "
            "confining stress; or G0 and density.",
        ),
    ] = None,
    campaign: CampaignName = None,
) -> None:
    """Write one self-contained page: configuration, tables, figures, failures, errors and run time."""
    from calcidem.app.config.measured import read_targets
    from calcidem.app.report.page import unnamed_page, write_report
    from calcidem.storage.files import refuse_to_replace
    from calcidem.storage.sql.store import read_campaign

    if out is None:
        with read_campaign(database, campaign) as store:
            out = unnamed_page(store)
    refuse_to_replace(out)
    targets = read_targets(measured, tell) if measured else ()
    studies = None
    if with_studies:
        from calcidem.app.studies.frequency_and_damping import run_studies

        studies = run_studies(database, campaign_name=campaign)
    with progress_bar("Report") as watch:
        page = write_report(
            database, out, campaign_name=campaign, studies=studies, measured=targets, files=files, watch=watch
        )
    typer.echo(f"Wrote {page}")
    if files is not None:
        typer.echo(f"Wrote {len(list(files.iterdir()))} files to {files}")
