"""``calcidem diagnose``: why cells have no velocity, and what to try."""

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from calcidem.app.cli.arguments import CampaignName, Database, OnlyContents, OnlySeeds
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.app.cli.terminal import printable, tell
from calcidem.sweep.progress import pluralize

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.campaign.diagnosis import Diagnosis
    from calcidem.app.campaign.remedy_trials import RemedyTrial
    from calcidem.storage.records import CampaignRecord
    from calcidem.storage.sql.store import Store

_MOST_SHOWN = 12
"""Cells that are shown one by one if none is chosen."""

_WIDTH = 110
"""Columns of the printed table."""


def diagnose_command(
    database: Database,
    seed: OnlySeeds = None,
    content: OnlyContents = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for a figure of each cell's section.")
    ] = None,
    trials: Annotated[
        int, typer.Option("--try", min=0, metavar="N", help="Compute N of these cells again with each remedy.")
    ] = 0,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Explain why cells have no velocity, and propose values of the configuration that may give one.

    Computing such a cell again gives the same result; another configuration is another campaign. --try tests the
    remedies on some of the cells, beside readable ones of the same content. Nothing is written to the database.
    """
    from calcidem.app.campaign.diagnosis import diagnose
    from calcidem.app.cli.tables import make_console
    from calcidem.storage.sql.store import read_campaign
    from calcidem.storage.store import Selection

    with read_campaign(database, campaign) as store:
        found = diagnose(store, Selection(seed, content), tell)
        if layout is not Format.TABLE:
            tell_rows([_diagnosis_row(diagnosis) for diagnosis in found], layout)
            return
        typer.echo(printable("\n".join(_overview_lines(store, found, chosen=bool(seed or content)))))
        shown = found if seed or content else found[:_MOST_SHOWN]
        for diagnosis in shown:
            typer.echo(printable("\n".join(["", *_cell_lines(diagnosis)])))
            for file in _save_picture(diagnosis, out):
                typer.echo(f"  Wrote {file}")
        if len(shown) < len(found):
            typer.echo(f"\nand {len(found) - len(shown)} more; choose with --content and --seed")
        tried = _try(store, found, trials) if trials else []
        if tried:
            make_console().print(_trial_table(found, tried, trials))
        for line in _frequency_lines(store.record, found, tried):
            typer.echo(printable(line))


def _overview_lines(store: "Store", found: "Sequence[Diagnosis]", *, chosen: bool) -> Iterator[str]:
    """How many cells have no velocity, at which contents, and what else there is."""
    from calcidem.storage.records import CellStatus

    counts: Counter[CellStatus] = Counter()
    for (_, status), number in store.status_counts().items():
        counts[status] += number
    total = pluralize(sum(counts.values()), "cell")
    unread = counts[CellStatus.NO_ARRIVAL] + counts[CellStatus.UNSTABLE]
    if not unread:
        yield f"Campaign {store.record.name}: every computed cell of its {total} has a velocity."
    else:
        yield f"Campaign {store.record.name}: {unread} of {total} have no velocity. Repeating the run does not help."
    if chosen and unread:
        yield f"Of the cells chosen these are {len(found)}."
    elif found:
        places = Counter(diagnosis.key.content for diagnosis in found)
        yield "They are " + ", ".join(f"{number} at {content:g} %" for content, number in sorted(places.items())) + "."
    packings: dict[str, list[str]] = {}
    for diagnosis in found:
        contents = packings.setdefault(diagnosis.packing, [])
        if f"{diagnosis.key.content:g}" not in contents:
            contents.append(f"{diagnosis.key.content:g}")
    for packing, contents in packings.items():
        if packing:
            yield f"All cells at {', '.join(contents)} % failed. Look at the packing first: {packing}"
    if others := counts[CellStatus.FAILED] + counts[CellStatus.TIMED_OUT]:
        yield f"{others} more failed or ran out of time: 'calcidem run CONFIG --retry failed --retry timed_out'."


def _diagnosis_row(diagnosis: "Diagnosis") -> dict[str, Any]:
    """What is known of a cell."""
    key, remedies = diagnosis.key, [str(remedy) for remedy in diagnosis.remedies]
    return {
        "seed": key.seed,
        "content": key.content,
        "status": diagnosis.status.value,
        "reason": diagnosis.reason,
        "finding": diagnosis.finding,
        "packing": diagnosis.packing,
        "remedies": "; ".join(remedies),
    }


def _cell_lines(diagnosis: "Diagnosis") -> Iterator[str]:
    """Reason, finding and remedies of a cell."""
    key = diagnosis.key
    yield f"seed {key.seed}, {key.content:g} %: {diagnosis.status.replace('_', ' ')}, {diagnosis.reason}"
    yield from textwrap.wrap(diagnosis.finding, _WIDTH, initial_indent="  ", subsequent_indent="  ")
    wide = max(len(str(remedy)) for remedy in diagnosis.remedies)
    for remedy in diagnosis.remedies:
        head = f"    {str(remedy).ljust(wide)}   "
        yield from textwrap.wrap(remedy.why, _WIDTH, initial_indent=head, subsequent_indent=" " * len(head))


def _save_picture(diagnosis: "Diagnosis", folder: Path | None) -> list[Path]:
    """Draw the section of a cell, if a folder is given."""
    if folder is None:
        return []
    from calcidem.analysis.figures.style import save

    name = f"seed{diagnosis.key.seed}_content{diagnosis.key.content:g}_diagnosis"
    return save(diagnosis.draw(), folder, name, ("png",))


def _frequency_lines(
    record: "CampaignRecord", found: "Sequence[Diagnosis]", tried: "Sequence[RemedyTrial]"
) -> Iterator[str]:
    """Frequencies that the remedies ask for, or that helped, as a configuration has them for all contents."""
    from calcidem.app.campaign.remedy_trials import frequency_table
    from calcidem.app.config.reference import written

    table = frequency_table(record, found, tried)
    if table is None:
        return
    yield "\nA frequency is meant for its content. For the whole campaign, under another name:\n"
    yield "    [wave.frequency]"
    for key, values in zip(("content", "frequency"), table, strict=True):
        yield f"    {key} = {written(values)}"


def _try(store: "Store", found: "Sequence[Diagnosis]", count: int) -> "list[RemedyTrial]":
    """Compute the remedies on some cells; the best of each content first."""
    from calcidem.app.campaign.remedy_trials import rank_trials, try_remedies

    return rank_trials(try_remedies(store, found, count, tell))


def _trial_table(found: "Sequence[Diagnosis]", trials: "Sequence[RemedyTrial]", count: int) -> Table:
    """What the remedies gave on some cells."""
    title = f"Tried on {min(count, len(found))} of {pluralize(len(found), 'cell')}; nothing is stored"
    table = Table(box=SIMPLE_HEAD, title=title, title_justify="left")
    table.add_column("content %", justify="right", no_wrap=True)
    table.add_column("set", no_wrap=True)
    for name in ("have Vs now", "Vs m/s (seed)", "Vs of neighbours"):
        table.add_column(name, no_wrap=name != "Vs m/s (seed)")
    for trial in trials:
        read = [f"{vs:.0f}\N{NO-BREAK SPACE}({seed})" for seed, vs in trial.velocities.items() if vs is not None]
        still = len(trial.neighbours) - trial.lost
        changes = [f"{trial.change:+.1%} on {still}"] * bool(still) + [f"{trial.lost} lost"] * bool(trial.lost)
        entries = (
            *(f"{trial.content:g}", str(trial.remedy), f"{trial.read} of {len(trial.velocities)}, {trial.outcome}"),
            *(trial.refusal or ", ".join(read) or "-", ", ".join(changes) or "there are none"),
        )
        table.add_row(*map(printable, entries))
    return table
