"""Check the method: ``calcidem verify``, ``accuracy`` and ``stability``."""

import math
from collections import Counter
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calcidem.app.campaign.notices import tell
from calcidem.app.cli.options import (
    DEFAULT_CONFIGURATION,
    SEEDS_AT_ONCE,
    CampaignName,
    ConfigurationFile,
    Database,
    JudgedDatabase,
    OnlyContents,
    StudyFolder,
    parse_percentage,
    say,
)
from calcidem.app.cli.output import Format, FormatOption, tell_rows, tell_study
from calcidem.sweep.schedule import EXIT_ERROR
from calcidem.wording import pluralize

if TYPE_CHECKING:
    from calcidem.app.campaign.opened import Campaign
    from calcidem.app.studies.verify import Verification


def verify_command(
    database: Database,
    cells: Annotated[int, typer.Option(min=1, help="Cells to compute again.")] = 4,
    choice: Annotated[int | None, typer.Option(min=0, metavar="SEED", help="Seed of their random choice.")] = None,
    integrity: Annotated[
        bool, typer.Option("--integrity", help="Only let SQLite check the whole file; exit code 1 if it is damaged.")
    ] = False,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Compute random cells again, on the stored packing, and compare status, readings, step, cement and sections.

    Exit codes: 0 same bits; 3 same to rounding: counts, status and cement are equal, relative differences at most 1e-9;
    1 different; 2 not comparable, such as another physics version.
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
                say(_verification_line(verification))
            found.append(verification)
    counts = Counter(verification.agreement for verification in found)
    if layout is Format.TABLE:
        verdicts = ", ".join(f"{counts[agreement]} {agreement}" for agreement in Agreement)
        say(f"{pluralize(len(found), 'cell')}: {verdicts}.")
    else:
        rows = [
            {
                "seed": one.stored.key.seed,
                "content": one.stored.key.content,
                "agreement": one.agreement.value,
                "most_different": one.most_different,
                "relative_difference": one.differences.get(one.most_different, 0.0),
                "differences": dict(one.differences),
            }
            for one in found
        ]
        tell_rows(rows, layout)
    codes = {Agreement.SAME_BITS: 0, Agreement.ROUNDING: EXIT_ROUNDING, Agreement.DIFFERENT: EXIT_ERROR}
    if code := codes[max(counts, key=list(Agreement).index)]:  # the worst of them
        raise typer.Exit(code)


def _verify_integrity(opened: "Campaign", layout: Format) -> None:
    """Name all damage of the file; exit code 1 if there is any."""
    from calcidem.storage.errors import DAMAGE_REMEDY

    damage = opened.store.damage()
    if layout is not Format.TABLE:
        tell_rows([{"damage": text} for text in damage], layout, names=("damage",))
    elif damage:
        say("\n".join((*damage, DAMAGE_REMEDY)))
    else:
        say("No damage was found.")
    if damage:
        raise typer.Exit(EXIT_ERROR)


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


def accuracy_command(
    configuration: ConfigurationFile = DEFAULT_CONFIGURATION,
    content: OnlyContents = None,
    seeds: Annotated[int, typer.Option(min=1, max=SEEDS_AT_ONCE, help="Seeds to measure.")] = 4,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SETTING",
            help="Only this setting beside the default, such as 'step_fraction 0.4' (repeatable).",
        ),
    ] = None,
    db: JudgedDatabase = None,
    out: StudyFolder = None,
    layout: FormatOption = Format.TABLE,
) -> None:
    """Measure error against run time of every numerical setting.

    A table has what the computation leaves out, why that is safe, and its cost. After a stop, the same command with
    --out continues.
    """
    from calcidem.app.config.reader import change_configuration, load_configuration
    from calcidem.app.studies.accuracy import accuracy, choose_settings
    from calcidem.app.studies.study import ROUNDS, Cells, StudyResult

    loaded = load_configuration(configuration)
    planned = change_configuration(loaded, {"campaign.contents": sorted(set(content or loaded.campaign.contents))})
    cells = Cells.of_campaign(planned, seeds, db, tell)
    try:
        compared = choose_settings(cells, only or ())
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    table = out and out / "accuracy.md"

    def write(part: StudyResult) -> None:
        if table is not None:
            list(part.write(table))

    former, rounds = table and table.with_suffix(".json"), 1 if only else ROUNDS
    result = accuracy(planned, cells, compared, rounds=rounds, former=former, tell=write)
    tell_study(result, layout, table)


def stability_command(
    configuration: Annotated[
        Path | None,
        typer.Argument(
            metavar="CONFIG", show_default=False, help="TOML file of the campaign; the preset quick if not given."
        ),
    ] = None,
    content: Annotated[
        float | None,
        typer.Option(
            parser=parse_percentage,
            metavar="PERCENT",
            help="Content of the scenes; the campaign's middle one if not given.",
        ),
    ] = None,
    scenes: Annotated[
        int, typer.Option(min=0, help="Random scenes, without a figure, instead of one quantity at a time.")
    ] = 0,
    draw: Annotated[int, typer.Option(min=0, metavar="SEED", help="Seed of the random scenes.")] = 1,
    db: JudgedDatabase = None,
    out: StudyFolder = None,
    layout: FormatOption = Format.TABLE,
) -> None:
    """Show which extreme values of step, bonds, damping, pulse and content are stable, refused or stopped.

    After a stop, the same command with --out continues. Exit code 1 if a velocity is silently wrong.
    """
    from calcidem.app.config.reader import load_configuration
    from calcidem.app.studies.stability import stability
    from calcidem.app.studies.study import Cells

    with as_file(files("calcidem.app.config.presets") / "quick.toml") as quick:
        loaded = load_configuration(configuration or quick)
    cells = Cells.of_campaign(loaded, 1, db, tell)
    middle = cells.contents[len(cells.contents) // 2]
    chosen = middle if content is None else content
    kept = out and out / "stability.partial.json"
    result = stability(loaded, cells.experiment, chosen, scenes=scenes, draw=draw, kept=kept, progress=tell)
    tell_study(result, layout, out and out / "stability.md")
    if result.is_wrong:
        raise typer.Exit(EXIT_ERROR)
