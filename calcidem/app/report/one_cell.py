"""A closer look at one sample: outcome, cement, path and signals."""

import os
from contextlib import suppress
from pathlib import Path

from calcidem.analysis.campaign_analysis import UnavailableError
from calcidem.analysis.figures.style import save
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.plots import CampaignPlots
from calcidem.app.report.cell_data import EXCEPTIONAL
from calcidem.app.report.wording import ABSENT, Table, decimal, readable_unit, significant
from calcidem.storage.records import QUANTITY_BY_NAME, Quantity
from calcidem.storage.store import Selection


def show_cell(
    database: str | os.PathLike[str],
    seed: int,
    content: float,
    out: str | os.PathLike[str] | None = None,
    *,
    campaign_name: str | None = None,
) -> tuple[Table, list[Path]]:
    """Describe one cell, and draw it if a folder is given.

    Parameters
    ----------
    database
        SQLite file or database URL.
    seed, content
        Which cell; content in percent.
    out
        Folder for the figures cement, path and signals, as far as the cell has what they need.
    campaign_name
        Which campaign, where the database has several.

    Returns
    -------
    tuple
        All quantities of the cell as a table, and the files written.

    Raises
    ------
    UnknownCellError
        If the cell has no outcome.
    StoreError
        If the database can't be read.
    """
    with open_campaign(database, campaign_name) as campaign:
        campaign.cell(seed=seed, content=content)  # says what is wrong if there is none
        values = campaign.store.table(list(QUANTITY_BY_NAME), Selection(seeds=(seed,), contents=(content,)))
        told = [
            quantity
            for quantity in QUANTITY_BY_NAME.values()
            if values[quantity.name][0] or quantity.name not in EXCEPTIONAL
        ]
        rows = [(quantity.meaning, _text(quantity, values[quantity.name][0])) for quantity in told]
        shown = tuple(row for row in rows if row[1] not in {"", ABSENT})
        files = [] if out is None else _draw(campaign.plot, seed, content, Path(out))
    return Table(f"Seed {seed} at {content:g} %.", ("quantity", "value"), shown), files


def _text(quantity: Quantity, value: str | float | None) -> str:
    if quantity.kind == "text" or isinstance(value, str):
        return str(value or "")
    text = decimal(value) if quantity.kind == "whole" else significant(value, 6)
    return text if text == ABSENT else f"{text} {readable_unit(quantity.unit)}".rstrip()


def _draw(plots: CampaignPlots, seed: int, content: float, folder: Path) -> list[Path]:
    files: list[Path] = []
    for name, draw in {"cement": plots.cement, "path": plots.path, "signals": plots.signal}.items():
        with suppress(UnavailableError):
            files += save(draw(seed=seed, content=content), folder, f"seed{seed}_content{content:g}_{name}")
    return files
