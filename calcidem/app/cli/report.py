"""``calcidem report``, ``analyse``, ``show`` and ``study``: what a campaign says, as a page, as files, cell by cell."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from calcidem.analysis.figures.sensitivity import STUDY_FIGURES
from calcidem.analysis.figures.style import save
from calcidem.app.cli.run_campaign import make_console
from calcidem.app.report import analyse, show_cell, write_report
from calcidem.app.studies.stored_studies import run_studies

Database = Annotated[str, typer.Argument(metavar="DB", help="SQLite file or database URL.")]
CampaignName = Annotated[str | None, typer.Option("--campaign", help="Which one, if the database has several.")]


class StudyName(StrEnum):
    """Sensitivity studies."""

    FREQUENCY = "frequency"
    DAMPING = "damping"


def report(
    database: Database,
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="Page to write or replace.")] = Path("report.html"),
    with_studies: Annotated[bool, typer.Option("--with-studies", help="Run the sensitivity studies for it.")] = False,
    campaign: CampaignName = None,
) -> None:
    """Write one self-contained page: what was run, tables, figures, what failed, errors and run time."""
    studies = run_studies(database, campaign_name=campaign) if with_studies else None
    typer.echo(f"Wrote {write_report(database, out, campaign_name=campaign, studies=studies)}")


def study(
    database: Database,
    names: Annotated[
        list[StudyName] | None, typer.Argument(metavar="[frequency|damping]...", help="By default both.")
    ] = None,
    content: Annotated[list[float] | None, typer.Option(help="Content, percent; may be repeated.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for figures and NetCDF files.")] = Path("studies"),
    campaign: CampaignName = None,
) -> None:
    """Study how Vs depends on the excitation frequency, the way of reading, and damping, on samples of a campaign."""
    chosen = [name.value for name in names or StudyName]
    results = run_studies(database, chosen, contents=content, campaign_name=campaign)
    for name, result in results.items():
        out.mkdir(parents=True, exist_ok=True)
        result.to_netcdf(out / f"study_{name}.nc")
        typer.echo(f"Wrote {out / f'study_{name}.nc'}")
        for entry in STUDY_FIGURES:
            if entry.study == name:
                for file in save(entry.draw(result), out, entry.name):
                    typer.echo(f"Wrote {file}")


def analyse_campaign(
    database: Database,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files; made if it is missing.")] = Path(
        "analysis"
    ),
    campaign: CampaignName = None,
) -> None:
    """Write all figures (PNG, SVG, PDF), tables (CSV) and numbers (NetCDF) of a campaign into a folder."""
    missing = analyse(database, out, campaign_name=campaign)
    for name, reason in missing.items():
        typer.echo(f"left out {name}: {reason}")
    typer.echo(f"Wrote {len(list(out.iterdir()))} files into {out}")


def show(
    database: Database,
    seed: Annotated[int, typer.Option(help="Seed of the cell.")],
    content: Annotated[float, typer.Option(help="Content of the cell, percent.")],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for its figures.")] = None,
    campaign: CampaignName = None,
) -> None:
    """Show one cell: what was measured, and with --out its packing, cement, path and signals as figures."""
    described, files = show_cell(database, seed, content, out, campaign_name=campaign)
    table = Table(*described.header, title=described.caption, title_justify="left", box=SIMPLE_HEAD)
    for row in described.rows:
        table.add_row(*row)
    make_console().print(table)
    for file in files:
        typer.echo(f"Wrote {file}")
