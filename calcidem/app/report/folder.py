"""All figures and tables of a campaign as files in a folder."""

import csv
import os
from collections.abc import Callable, Mapping
from pathlib import Path

import xarray as xr

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.distribution import tabulate
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.analysis.figures.style import save
from calcidem.app.report.sections import TABLES, make_or_explain
from calcidem.app.report.wording import ABSENT, Table
from calcidem.storage.files import spreadsheet_value
from calcidem.storage.netcdf.export import write_netcdf

_NUMBERS: Mapping[str, Callable[[CampaignAnalysis], xr.Dataset]] = {
    "distributions": lambda analysis: tabulate(analysis.distributions),
    "features": lambda analysis: analysis.table,
    "correlations_overall": lambda analysis: analysis.correlations.overall,
    "correlations_within_content": lambda analysis: analysis.correlations.within,
    "correlations_by_content": lambda analysis: analysis.content_correlations,
}
"""What NetCDF files hold, by their names."""


def write_files(analysis: CampaignAnalysis, out: str | os.PathLike[str]) -> dict[str, str]:
    """Write figures (PNG, SVG, PDF), tables (table_*.csv) and numbers (NetCDF) of a campaign into a folder.

    It is made if missing; files of the same names are replaced. Given is what could not be made, by name, with the
    reason. `OSError` if the folder can't be written.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    reasons: dict[str, str] = {}
    for entry in CAMPAIGN_FIGURES:
        figure, reasons[entry.name] = make_or_explain(entry.draw, analysis)
        if figure is not None:
            save(figure, folder, entry.name)
    for name, make in TABLES.items():
        table, reasons[f"table_{name}"] = make_or_explain(make, analysis)
        if table is not None:
            _write_table(table, folder / f"table_{name}.csv")
    for name, gather in _NUMBERS.items():
        numbers, reasons[name] = make_or_explain(gather, analysis)
        if numbers is not None:
            write_netcdf(numbers, folder / f"{name}.nc")
    return {name: reason for name, reason in reasons.items() if reason}


def _write_table(table: Table, file: Path) -> None:
    """Write a table as CSV, with the numbers as they stand in the report; the exact ones are in the NetCDF files."""
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(table.header)
        writer.writerows([spreadsheet_value(_typed(value)) for value in row] for row in table.rows)


def _typed(value: str) -> str:
    """Value with the signs that programs read: the minus of a keyboard, and nothing where it is missing."""
    return "" if value == ABSENT else value.replace("\N{MINUS SIGN}", "-")
