"""``calcidem compare``: comparison of campaigns."""

import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from calcidem.app.cli.arguments import Level
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.app.cli.terminal import printable

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    import pandas as pd

_FIGURE_FORMATS = (".png", ".svg", ".pdf")


def compare_command(
    databases: Annotated[list[str], typer.Argument(metavar="DB...", help="SQLite files or database URLs.")],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Figure to write: .png, .svg or .pdf.")] = None,
    layout: FormatOption = Format.TABLE,
    level: Level = 0.95,
    campaign: Annotated[
        list[str] | None,
        typer.Option("--campaign", metavar="NAME", help="Campaigns of one database; repeat it."),
    ] = None,
) -> None:
    """Compare campaigns with the first of them, content by content: mean and scatter of Vs, and their differences.

    The difference of means treats all samples as independent (Welch). The paired difference uses the shared seeds; its
    interval is narrower if a seed places the cement alike in both campaigns.
    """
    from calcidem.app.campaign.comparison import compare
    from calcidem.app.campaign.opened import open_campaign
    from calcidem.storage.files import refuse_to_replace, write_atomically

    if campaign and len(databases) > 1:
        raise typer.BadParameter("give one database with it", param_hint="--campaign")
    if out is not None:
        if out.suffix.lower() not in _FIGURE_FORMATS:
            raise typer.BadParameter(f"{out} ends with none of {', '.join(_FIGURE_FORMATS)}", param_hint="--out")
        refuse_to_replace(out)
    names: list[str | None] = list(campaign) if campaign else [None]
    with ExitStack() as stack:
        opened = [stack.enter_context(open_campaign(database, name)) for database in databases for name in names]
        found = compare(opened, level)
    table = found.to_dataframe()
    if layout is Format.TABLE:
        from calcidem.app.cli.tables import make_console

        console = make_console()
        console.print(_comparison_table(table, level))
        for name, lines in found.differing.items():
            typer.echo(printable(f"{name} differs from the first in: {'; '.join(lines) or 'nothing'}"))
    else:
        tell_rows(table.astype(object).where(table.notna(), None).to_dict("records"), layout)
    if out is not None:
        from calcidem.analysis.figures.style import render

        with write_atomically(out) as temporary:
            temporary.write_bytes(render(found.draw(), out.suffix.lower().removeprefix(".")))
        typer.echo(f"Wrote {out}", err=layout is not Format.TABLE)


def _comparison_table(table: "pd.DataFrame", level: float) -> Table:
    """Table for people: contents together, campaigns below one another."""
    from calcidem.app.cli.tables import make_table

    shown = make_table("Shear-wave velocity, m/s", numbers=["content %"])
    shown.add_column("campaign", overflow="fold", min_width=12)
    for name in ("n", "mean", "sd", "difference", "paired", "pairs", "sd ratio"):
        shown.add_column(name, justify="right")
    for content, rows in table.groupby("content"):
        for place, (_, row) in enumerate(rows.iterrows()):
            shown.add_row(
                "" if place else f"{content:g}",
                Text(printable(str(row["campaign"]))),
                str(row["n"]),
                *(
                    _with_interval(row, name)
                    for name in ("mean", "standard_deviation", "difference", "paired_difference")
                ),
                str(row["pairs"]).replace("<NA>", "-"),
                _with_interval(row, "deviation_ratio", "{:.2f}"),
            )
    shown.caption = (
        f"In brackets: {100 * level:g} % intervals. Differences are to the first campaign: of all samples, and of the "
        "seeds that both have (paired), as is the ratio of the standard deviations."
    )
    return shown


def _with_interval(row: "pd.Series[Any]", name: str, form: str = "{:.0f}") -> str:
    """A number of a row and its interval in brackets."""
    value, low, high = (float(row[f"{name}{end}"]) for end in ("", "_interval_low", "_interval_high"))
    if not math.isfinite(value):
        return "-"
    text = form.format(value)
    return f"{text} ({form.format(low)} to {form.format(high)})" if math.isfinite(low) else text
