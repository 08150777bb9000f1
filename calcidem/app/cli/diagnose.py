"""``calcidem diagnose``: why cells have no velocity, and what to try."""

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calcidem.app.cli.arguments import CampaignName, Database, OnlyContents, OnlySeeds
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.app.cli.terminal import printable
from calcidem.sweep.progress import pluralize

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.campaign.diagnosis import Diagnosis
    from calcidem.storage.sql.store import Store

_WIDTH = 110  # columns


def diagnose_command(
    database: Database,
    seed: OnlySeeds = None,
    content: OnlyContents = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for a figure of each cell's section.")
    ] = None,
    trial: Annotated[bool, typer.Option("--try", help="Compute these cells again with the remedies.")] = False,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Explain why cells have no velocity, and propose values of the configuration that may give one.

    Computing such a cell again gives the same result; another configuration is another campaign. --try adds the
    remedies to one another until the velocity is as expected. Nothing is written to the database.
    """
    from calcidem.app.campaign.diagnosis import diagnose
    from calcidem.storage.sql.store import read_campaign
    from calcidem.storage.store import Selection

    with read_campaign(database, campaign) as store:
        found = diagnose(store, Selection(seed, content))
        if layout is not Format.TABLE:
            tell_rows([_table_row(one) for one in found], layout)
            return
        typer.echo(printable("\n".join(_overview_lines(store, found))))
        for one in found:
            typer.echo(printable("\n".join(["", *_cell_lines(one, trial=trial)])))
            if out is not None:
                from calcidem.analysis.figures.style import save

                name = f"seed{one.key.seed}_content{one.key.content:g}_diagnosis"
                typer.echo(f"  Wrote {save(one.draw(), out, name, ('png',))[0]}")


def _table_row(one: "Diagnosis") -> dict[str, Any]:
    """What is said of a cell."""
    said = {name: str(getattr(one, name)) for name in ("status", "reason", "finding", "packing")}
    return {"seed": one.key.seed, "content": one.key.content, **said, "remedies": "; ".join(map(str, one.remedies))}


def _overview_lines(store: "Store", found: "Sequence[Diagnosis]") -> Iterator[str]:
    """How many cells have no velocity, at which contents, and what their packing is like where all have none."""
    total, places = pluralize(sum(store.status_counts().values()), "cell"), Counter(one.key.content for one in found)
    words = ", ".join(f"{number} at {content:g} %" for content, number in sorted(places.items()))
    yield f"Campaign {store.record.name}, {total}. Without velocity: {words or 'none'}. Repeating does not help."
    packings = {one.key.content: one.packing for one in found if one.packing}
    for packing in dict.fromkeys(packings.values()):
        contents = ", ".join(f"{content:g}" for content in sorted(packings) if packings[content] == packing)
        yield f"All cells at {contents} % failed. Look at the packing first: {packing}"


def _cell_lines(one: "Diagnosis", *, trial: bool) -> Iterator[str]:
    """Reason, finding and remedies of a cell, with what came of these if they are tried."""
    yield f"seed {one.key.seed}, {one.key.content:g} %: {one.status.replace('_', ' ')}, {one.reason}"
    yield from textwrap.wrap(one.finding, _WIDTH, initial_indent="  ", subsequent_indent="  ")
    outcomes = list(one.try_remedies()) if trial else []
    for number, remedy in enumerate(one.remedies):
        yield f"    {str(remedy).ljust(35)} {remedy.why}"
        if number < len(outcomes):
            _, vs, reason = outcomes[number]
            found = ", ".join(filter(None, (f"Vs {vs:.0f} m/s" if vs else "", reason)))
            yield f"      {'and ' * (number > 0)}tried: {found}"
