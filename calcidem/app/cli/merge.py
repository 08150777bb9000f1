"""``calcidem merge``: one database from several of the same campaign."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.campaign.merge import Conflict, Merged, merge_campaigns
from calcidem.storage.campaign import open_stored_campaign
from calcidem.storage.errors import StoreError
from calcidem.storage.netcdf.export import replaced_atomically
from calcidem.storage.sql.store import open_store

MOST_NAMED = 10
"""Conflicts that are named one by one; more are only counted."""


class MergeConflictError(StoreError):
    """Databases have different values for the same cells."""


def merge(
    sources: Annotated[list[str], typer.Argument(metavar="A.db B.db ...", help="Databases of the same campaign.")],
    out: Annotated[Path, typer.Option(metavar="C.db", help="SQLite file to write; must not exist yet.")],
    prefer: Annotated[
        str | None, typer.Option(metavar="A.db", help="Whose value to take where databases disagree on a done cell.")
    ] = None,
    campaign: Annotated[
        str | None, typer.Option("--campaign", help="Which one, if the databases have several.")
    ] = None,
) -> None:
    """Join databases of one campaign, such as those of several seed ranges, into a new one.

    Done cells win over all others. Where two databases have different values for the same done cell, nothing is written
    unless --prefer says which to take.
    """
    if prefer is not None and prefer not in sources:
        raise typer.BadParameter(f"{prefer} is none of {', '.join(sources)}.", param_hint="--prefer")
    merged = merge_databases(sources, out, prefer, campaign)
    for line in merge_lines(merged, sources, out):
        typer.echo(line)


def merge_databases(
    sources: list[str], out: Path, prefer: str | None = None, campaign_name: str | None = None
) -> Merged:
    """Join the campaign of some databases in a new file, which appears only once it is complete.

    Parameters
    ----------
    sources
        SQLite files or database URLs; they are only read.
    out
        File to make.
    prefer
        The source whose value is taken where sources disagree on a done cell.
    campaign_name
        Which one, if the databases have several.

    Raises
    ------
    FileExistsError
        If the file is there already.
    MergeConflictError
        If sources disagree on a done cell and none is preferred.
    StoreError
        `CampaignMismatchError` if configurations or packings differ, and others if a database can't be read.
    """
    if out.exists():
        raise FileExistsError(f"{out} exists already; give another file name for the merged database.")
    with ExitStack() as stack:
        campaigns = [stack.enter_context(open_stored_campaign(source, campaign_name)) for source in sources]
        temporary = stack.enter_context(replaced_atomically(out.absolute()))
        with open_store(temporary) as store:
            merged = merge_campaigns(campaigns, store, None if prefer is None else sources.index(prefer))
        if merged.conflicts and prefer is None:
            raise conflict_error(merged.conflicts, sources)
    return merged


def conflict_error(conflicts: tuple[Conflict, ...], sources: list[str]) -> MergeConflictError:
    """Error that lists the conflicts."""
    return MergeConflictError(
        f"{len(conflicts)} done cells have different values:\n" + "\n".join(conflict_lines(conflicts, sources)) + "\n",
        "Nothing was written. Such values come from another kind of CPU or another version of calcidem; "
        "give --prefer with the database to take.",
    )


def conflict_lines(conflicts: tuple[Conflict, ...], sources: list[str]) -> list[str]:
    """One line for each conflict, up to a number."""
    lines = [
        f"  seed {conflict.key.seed}, {conflict.key.content:g} %: "
        + ", ".join(f"Vs {velocity:.9g} m/s in {sources[source]}" for source, velocity in conflict.velocities.items())
        + f" (different: {', '.join(conflict.quantities)})"
        for conflict in conflicts[:MOST_NAMED]
    ]
    return lines if len(conflicts) <= MOST_NAMED else [*lines, f"  and {len(conflicts) - MOST_NAMED} more"]


def merge_lines(merged: Merged, sources: list[str], out: Path) -> list[str]:
    """What was done, for a person."""
    taken = [f"  {number} cells from {source}" for source, number in zip(sources, merged.taken, strict=True)]
    lines = [f"Merged {merged.settled} settled cells of {merged.planned} planned ones into {out}:", *taken]
    if merged.shared:
        lines.append(f"  {merged.shared} cells were in several databases with the same values")
    if merged.overruled:
        lines.append(f"  {merged.overruled} cells that went wrong in one database are done in another")
    if merged.conflicts:
        lines.append(f"  {len(merged.conflicts)} done cells had different values, taken as --prefer says:")
        lines += ["  " + line for line in conflict_lines(merged.conflicts, sources)]
    if merged.settled < merged.planned:
        lines.append(f"The other cells are pending; 'calcidem run CONFIG --db {out}' computes them.")
    return lines
