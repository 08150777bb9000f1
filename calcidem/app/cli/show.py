"""``calcidem show``: quantities and figures of one cell."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from calcidem.app.campaign.notices import printable
from calcidem.app.cli.arguments import HIGHEST_SEED, CampaignName, Database, parse_percentage
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.app.cli.terminal import progress_bar
from calcidem.ends import Verdict

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.campaign.opened import Campaign


def show_command(
    database: Database,
    seed: Annotated[int, typer.Option(min=0, max=HIGHEST_SEED, help="Seed of the cell.")],
    content: Annotated[
        float, typer.Option(parser=parse_percentage, metavar="PERCENT", help="Calcite content of the cell.")
    ],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the figures of the cell.")] = None,
    movie: Annotated[Path | None, typer.Option(metavar="FILE", help="Movie of the wave, .gif or .mp4.")] = None,
    frames: Annotated[int, typer.Option(min=2, help="Most frames of the movie, at 15 a second.")] = 90,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Show one cell: its quantities, or why it has no velocity and what may give one.

    With --out also figures: cement, path, signals, and the section with the candidates for the S wave.
    """
    from calcidem.app.cli.query import as_rows
    from calcidem.storage.records import QUANTITY_BY_NAME
    from calcidem.storage.sql.store import read_campaign
    from calcidem.storage.store import Selection

    with read_campaign(database, campaign) as store:
        store.cell(seed=seed, content=content)  # raises an error if there is none
        (row,) = as_rows(store.table(tuple(QUANTITY_BY_NAME), Selection(seeds=(seed,), contents=(content,))))
    if layout is Format.TABLE:
        from calcidem.app.cli.tables import make_console, make_table

        table = make_table(f"Seed {seed} at {content:g} %.", "quantity", "value")
        for meaning, value in _cell_rows(row):
            table.add_row(meaning, Text(printable(value)))
        if verdict := Verdict.of(row["reason"] or ""):
            table.add_row("remedy", verdict.remedy)
        make_console().print(table)
    else:
        tell_rows([row], layout)
    if out is None and movie is None:
        return
    from calcidem.app.campaign.opened import open_campaign

    with open_campaign(database, campaign) as opened:
        for file in () if out is None else _draw_cell(opened, seed, content, out):
            typer.echo(f"Wrote {file}", err=layout is not Format.TABLE)
        if movie is not None:
            with progress_bar("Movie") as watch:
                opened.plot.movie(movie, seed=seed, content=content, frames=frames, watch=watch)
            typer.echo(f"Wrote {movie}", err=layout is not Format.TABLE)


def _cell_rows(row: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Meanings and values, with units, of the quantities of a cell that it has."""
    from calcidem.app.report.wording import ABSENT, EXCEPTIONAL, decimal, readable_unit, significant
    from calcidem.storage.records import QUANTITY_BY_NAME

    for name, value in row.items():
        quantity = QUANTITY_BY_NAME[name]
        if quantity.kind == "text":
            text = str(value or "")
        else:
            is_share = quantity.meaning.startswith("relative")
            text = decimal(value) if quantity.kind == "whole" else significant(100 * value if is_share else value, 4)
            text += " %" if is_share and text != ABSENT else ""
        if text in {"", ABSENT} or (name in EXCEPTIONAL and not value):
            continue
        yield quantity.meaning, text if quantity.kind == "text" else f"{text} {readable_unit(quantity.unit)}".rstrip()


def _draw_cell(opened: "Campaign", seed: int, content: float, folder: Path) -> Iterator[Path]:
    """Draw a cell into a folder as far as it has what the figures need, and give the files."""
    from calcidem.analysis.campaign_analysis import UnavailableError
    from calcidem.analysis.figures.style import save

    plot = opened.plot
    figures = {"cement": plot.cement, "path": plot.path, "signals": plot.signal, "section": plot.section}
    for name, draw in figures.items():
        with suppress(UnavailableError):
            yield from save(draw(seed=seed, content=content), folder, f"seed{seed}_content{content:g}_{name}")
