"""``calcidem verify``: compute stored cells again and compare."""

import math
from collections import Counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calcidem.app.campaign.notices import printable
from calcidem.app.cli.arguments import CampaignName, Database
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.sweep.schedule import EXIT_ERROR, pluralize

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.campaign.opened import Campaign
    from calcidem.app.studies.verify import Verification


def verify_command(
    database: Database,
    cells: Annotated[int, typer.Option(min=1, help="Number of cells to compute again.")] = 4,
    choice: Annotated[
        int | None,
        typer.Option(min=0, metavar="SEED", help="Seed of their random choice."),
    ] = None,
    integrity: Annotated[
        bool, typer.Option("--integrity", help="Compute nothing: let SQLite check the whole file.")
    ] = False,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Compute random cells of a campaign again, on its own packing, and compare them with the stored ones.

    Status, readings, step, cement and stored sections are compared. --integrity names the damage that SQLite finds in
    the file; exit code 1 if there is any.

    Exit codes: 0 same bits; 3 same to rounding, all relative differences at most 1e-9; 1 different; 2 not comparable,
    such as cells of another physics version.
    """
    from calcidem.app.campaign.opened import open_campaign
    from calcidem.app.cli.exit_codes import EXIT_ROUNDING
    from calcidem.app.studies.verify import Agreement, random_cells, verify

    with open_campaign(database, campaign) as opened:
        if integrity:
            _verify_integrity(opened, layout)
            return
        keys = random_cells(opened.store, cells, choice)
        found = []
        for verification in verify(opened.store, keys, opened.experiment):
            if layout is Format.TABLE:
                typer.echo(printable(_verification_line(verification)))
            found.append(verification)
    counts = Counter(verification.agreement for verification in found)
    if layout is Format.TABLE:
        verdicts = ", ".join(f"{counts[agreement]} {agreement}" for agreement in Agreement)
        typer.echo(f"{pluralize(len(found), 'cell')}: {verdicts}.")
    else:
        tell_rows([_verification_row(verification) for verification in found], layout)
    codes = {Agreement.SAME_BITS: 0, Agreement.ROUNDING: EXIT_ROUNDING, Agreement.DIFFERENT: EXIT_ERROR}
    if code := codes[max(counts, key=list(Agreement).index)]:  # the worst of them
        raise typer.Exit(code)


def _verify_integrity(opened: "Campaign", layout: Format) -> None:
    """Name all damage of the file; exit code 1 if there is any."""
    from calcidem.storage.sql.engine import DAMAGE_REMEDY

    damage = opened.store.damage()
    if layout is not Format.TABLE:
        tell_rows([{"damage": text} for text in damage], layout, names=("damage",))
    elif damage:
        typer.echo(printable("\n".join((*damage, DAMAGE_REMEDY))))
    else:
        typer.echo("No damage was found.")
    if damage:
        raise typer.Exit(EXIT_ERROR)


def _verification_row(verification: "Verification") -> dict[str, Any]:
    """Result for one cell."""
    key, name = verification.stored.key, verification.most_different
    size = verification.differences[name] if name else 0.0
    return {
        "seed": key.seed,
        "content": key.content,
        "agreement": verification.agreement.value,
        "most_different": name,
        "relative_difference": size,
        "differences": dict(verification.differences),
    }


def _verification_line(verification: "Verification") -> str:
    """Result for one cell, with the quantity that differs most and its difference."""
    key, name = verification.stored.key, verification.most_different
    text = f"{key}: {verification.agreement}"
    if not name:
        return text
    size = verification.differences[name]
    stored, computed = (getattr(result, name, None) for result in (verification.stored, verification.computed))
    amount = "" if stored is computed is None else f": stored {stored}, computed {computed}"
    if math.isfinite(size):
        amount = f", relative difference {size:.2g}"
    others = len(verification.differences) - 1
    also = f"; {others} other{'s' if others > 1 else ''} differ{'' if others > 1 else 's'}" if others else ""
    return f"{text} (most of all {name}{amount}{also})"
