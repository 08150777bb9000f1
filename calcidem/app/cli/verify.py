"""``calcidem verify``: compute stored cells again and compare."""

from collections.abc import Sequence
from typing import Annotated

import typer

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.cli.arguments import CampaignName, Database
from calcidem.app.studies.verify import Verification, random_cells, verify


def verify_command(
    database: Database,
    cells: Annotated[int, typer.Option(min=1, help="Number of cells to compute again.")] = 4,
    choice: Annotated[
        int | None,
        typer.Option(metavar="SEED", help="Seed of their random choice; by default a new one each time."),
    ] = None,
    campaign: CampaignName = None,
) -> None:
    """Compute random cells of a campaign again and compare: to the last bit on the same kind of CPU.

    Ends with 1 if a cell differs.
    """
    with open_campaign(database, campaign) as opened:
        keys = random_cells(opened, cells, choice)
        found = []
        for verification in verify(opened, keys, opened.experiment):
            typer.echo(verification_line(verification))
            found.append(verification)
    typer.echo(verification_summary(found))
    if not all(verification.agreement.good for verification in found):
        raise typer.Exit(1)


def verification_line(verification: Verification) -> str:
    """What came of one cell."""
    key = verification.stored.key
    text = f"seed {key.seed}, {key.content:g} %: {verification.agreement}"
    if not verification.differences:
        return text
    change = verification.relative_difference
    difference = "" if change is None else f"; relative difference of Vs {change:+.2g}"
    return f"{text} ({', '.join(verification.differences)}{difference})"


def verification_summary(found: Sequence[Verification]) -> str:
    """The last line."""
    good = sum(verification.agreement.good for verification in found)
    return f"{good} of {len(found)} cells confirmed."
