"""A closer look at one sample: its outcome in numbers (`calcidem.app.report.cell_figures` draws it)."""

import os

from calcidem.app.report.wording import ABSENT, EXCEPTIONAL, Table, decimal, readable_unit, significant
from calcidem.storage.records import QUANTITY_BY_NAME, Quantity
from calcidem.storage.sql.store import read_campaign
from calcidem.storage.store import Selection


def describe_cell(
    database: str | os.PathLike[str], seed: int, content: float, *, campaign_name: str | None = None
) -> Table:
    """Give all quantities of one cell as a table; content in percent.

    `UnknownCellError` if the cell has no outcome, `StoreError` if the database can't be read.
    """
    with read_campaign(database, campaign_name) as store:
        store.cell(seed=seed, content=content)  # raises a clear error if there is none
        values = store.table(list(QUANTITY_BY_NAME), Selection(seeds=(seed,), contents=(content,)))
    told = [
        quantity
        for quantity in QUANTITY_BY_NAME.values()
        if values[quantity.name][0] or quantity.name not in EXCEPTIONAL
    ]
    rows = [(quantity.meaning, _text(quantity, values[quantity.name][0])) for quantity in told]
    shown = tuple(row for row in rows if row[1] not in {"", ABSENT})
    return Table(f"Seed {seed} at {content:g} %.", ("quantity", "value"), shown)


def _text(quantity: Quantity, value: str | float | None) -> str:
    if quantity.kind == "text" or isinstance(value, str):
        return str(value or "")
    text = decimal(value) if quantity.kind == "whole" else significant(value, 6)
    return text if text == ABSENT else f"{text} {readable_unit(quantity.unit)}".rstrip()
