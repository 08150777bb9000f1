"""``calcidem study``: how Vs depends on excitation frequency and damping, on samples of a campaign."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import CampaignName, Database, OnlyContents

_StudyName = StrEnum("_StudyName", ["FREQUENCY", "DAMPING"])


def study_command(
    database: Database,
    names: Annotated[
        list[_StudyName] | None, typer.Argument(metavar="frequency|damping", help="By default both.")
    ] = None,
    content: OnlyContents = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for figures and NetCDF files.")] = Path("studies"),
    campaign: CampaignName = None,
) -> None:
    """Study how Vs depends on excitation frequency, method of reading and damping, on samples of a campaign."""
    from calcidem.analysis.figures.sensitivity import STUDY_FIGURES
    from calcidem.analysis.figures.style import save
    from calcidem.app.studies.frequency_and_damping import run_studies
    from calcidem.storage.netcdf.export import write_netcdf

    chosen = [name.value for name in names or _StudyName]
    results = run_studies(database, chosen, contents=content, campaign_name=campaign)
    for name, result in results.items():
        out.mkdir(parents=True, exist_ok=True)
        write_netcdf(result, out / f"study_{name}.nc")
        typer.echo(f"Wrote {out / f'study_{name}.nc'}")
        for entry in STUDY_FIGURES:
            if entry.study == name:
                for file in save(entry.draw(result), out, entry.name):
                    typer.echo(f"Wrote {file}")
