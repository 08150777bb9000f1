"""All figures and tables of a campaign as files in a folder."""

import csv
import os
from collections.abc import Callable
from pathlib import Path

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError
from calcidem.analysis.distribution import tabulate
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.analysis.figures.style import save
from calcidem.app.report.comparison import disagreement_table, published_table
from calcidem.app.report.results import (
    cost_table,
    feature_table,
    growth_table,
    law_table,
    meaning_table,
    outcome_table,
    velocity_table,
)
from calcidem.app.report.wording import Table
from calcidem.storage.campaign import open_stored_campaign

_TABLES: dict[str, Callable[[CampaignAnalysis], Table | None]] = {
    "velocities": velocity_table,
    "meaning": meaning_table,
    "outcomes": outcome_table,
    "growth": growth_table,
    "features": feature_table,
    "laws": lambda analysis: law_table([analysis.physical_law, analysis.scanned_law]),
    "errors_and_cost": cost_table,
    "published": published_table,
    "published_disagreements": lambda _: disagreement_table(),
}


def analyse(
    database: str | os.PathLike[str], out: str | os.PathLike[str], *, campaign_name: str | None = None
) -> dict[str, str]:
    """Write figures (PNG, SVG, PDF), tables (table_*.csv) and numbers (NetCDF) of a campaign into a folder.

    Parameters
    ----------
    database
        SQLite file or database URL.
    out
        Folder; made if missing, files of the same names are replaced.
    campaign_name
        Which campaign, where the database has several.

    Returns
    -------
    dict
        What could not be made, by name, with the reason.

    Raises
    ------
    StoreError
        If the database can't be read.
    OSError
        If the folder can't be written.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    left_out: dict[str, str] = {}
    with open_stored_campaign(database, campaign_name) as campaign:
        analysis = CampaignAnalysis(campaign)
        for entry in CAMPAIGN_FIGURES:
            try:
                save(entry.draw(analysis), folder, entry.name)
            except UnavailableError as error:
                left_out[entry.name] = str(error)
        for name, make in _TABLES.items():
            try:
                table = make(analysis)
            except UnavailableError as error:
                left_out[name] = str(error)
            else:
                if table is not None:
                    _write_table(table, folder / f"table_{name}.csv")
        tabulate(analysis.distributions).to_netcdf(folder / "distributions.nc")
        try:
            analysis.table.to_netcdf(folder / "features.nc")
            analysis.correlations.overall.to_netcdf(folder / "correlations_overall.nc")
            analysis.correlations.within.to_netcdf(folder / "correlations_within_content.nc")
        except UnavailableError as error:
            left_out["features.nc"] = str(error)
    return left_out


def _write_table(table: Table, file: Path) -> None:
    """Write a table as CSV, as it stands in the report; the exact numbers are in the NetCDF files."""
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(table.header)
        writer.writerows(table.rows)
