"""``calcidem diagnose``: reasons why cells have no velocity, and remedies."""

import textwrap
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import CampaignName, Database, OnlyContents, OnlySeeds
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.app.cli.terminal import printable


def diagnose_command(
    database: Database,
    seed: OnlySeeds = None,
    content: OnlyContents = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for a figure of each cell's section.")
    ] = None,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Explain why cells have no velocity, and propose values of the configuration that may give one.

    Each cell is computed again with trial values. The command names the fewest that give the velocity of all of them,
    or one near the static speed. The database is not written.
    """
    from calcidem.app.campaign.diagnosis import diagnose
    from calcidem.app.campaign.status import UNREAD
    from calcidem.storage.sql.store import read_campaign
    from calcidem.storage.store import Selection

    with read_campaign(database, campaign) as store:
        found = diagnose(store, Selection(seed, content))
        if layout is Format.TABLE:
            counts = [(key, number) for key, number in store.status_counts().items() if key[1] in UNREAD]
            words = ", ".join(f"{number} at {content:g} % ({status})" for (content, status), number in sorted(counts))
            unread = f"{words}. A new run would give the same." if words else "none."
            typer.echo(printable(f"Campaign {store.record.name}. Without velocity: {unread}"))
        rows = []
        for one in found:
            rows.append(one.as_row())
            if layout is Format.TABLE:
                head = f"\n{one.key}: {one.status.words}, {one.reason}"
                lines = head, *textwrap.wrap(one.finding, 110), *one.describe_remedies()
                typer.echo(printable("\n  ".join(lines)))
            if out is not None:
                from calcidem.analysis.figures.style import save

                name = f"seed{one.key.seed}_content{one.key.content:g}_diagnosis"
                typer.echo(f"  Wrote {save(one.draw(), out, name, ('png',))[0]}", err=layout is not Format.TABLE)
    if layout is not Format.TABLE:
        names = ("seed", "content", "status", "reason", "finding", "vs", "remedies")
        tell_rows(rows, layout, names=names)
