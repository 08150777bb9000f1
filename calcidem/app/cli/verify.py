"""``calcidem verify``: compute stored cells again and compare."""

from collections.abc import Sequence
from typing import Annotated

import typer

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.studies.verify import Verification, random_cells, verify


def verify_cells(
    database: Annotated[str, typer.Argument(help="SQLite file or database URL.")],
    cells: Annotated[int, typer.Option(min=1, help="How many cells to compute again.")] = 4,
    choice: Annotated[
        int | None, typer.Option(help="Seed of their random choice; another one each time without.")
    ] = None,
    campaign: Annotated[str | None, typer.Option(help="Which campaign, where there are several.")] = None,
) -> None:
    """Compute random cells of a campaign again and compare: to the last bit on the same kind of CPU.

    Ends with 1 if a cell came out different.
    """
    with open_campaign(database, campaign) as opened:
        keys = random_cells(opened, cells, choice)
        found = []
        for verification in verify(opened, keys, opened.experiment):
            typer.echo(line(verification))
            found.append(verification)
    typer.echo(conclusion(found))
    if not all(verification.verdict.good for verification in found):
        raise typer.Exit(1)


def line(verification: Verification) -> str:
    """Return what became of one cell."""
    key = verification.stored.key
    text = f"seed {key.seed}, {key.content:g} %: {verification.verdict}"
    if not verification.differences:
        return text
    change = verification.relative_difference
    difference = "" if change is None else f", Vs by {change:+.2g} of it"
    return f"{text} ({', '.join(verification.differences)}{difference})"


def conclusion(found: Sequence[Verification]) -> str:
    """Return the last line."""
    good = sum(verification.verdict.good for verification in found)
    return f"{good} of {len(found)} cells confirmed."
