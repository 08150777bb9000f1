"""``calcidem merge``: one database from several databases of the same campaign."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calcidem.app.campaign.notices import printable
from calcidem.app.cli.arguments import CampaignName

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.campaign.merge import Merged


def merge_command(
    sources: Annotated[list[str], typer.Argument(metavar="A.db B.db ...", help="Databases of the same campaign.")],
    out: Annotated[Path, typer.Option(metavar="C.db", help="SQLite file to write; new, or of the same campaign.")],
    prefer: Annotated[
        str | None,
        typer.Option(metavar="A.db", help="Database to take where values differ."),
    ] = None,
    campaign: CampaignName = None,
) -> None:
    """Merge databases of one campaign, such as those of `calcidem run --part`, into one.

    A done cell replaces any other. Different values of a done cell are refused unless --prefer chooses.
    """
    from calcidem.app.campaign.merge import merge_databases

    if prefer is not None and prefer not in sources:
        raise typer.BadParameter(f"{prefer} is none of {', '.join(sources)}.", param_hint="--prefer")
    merged = merge_databases(sources, out, prefer, campaign)
    typer.echo(printable("\n".join(_merge_lines(merged, out))))


def _merge_lines(merged: "Merged", out: Path) -> list[str]:
    """Describe the merge."""
    taken = [f"  {number} cells from {source}" for source, number in zip(merged.sources, merged.taken, strict=True)]
    lines = [
        f"Wrote {out}: {merged.settled} of {merged.settled + len(merged.missing)} planned cells are finished",
        *taken,
    ]
    if merged.shared:
        lines.append(f"  {merged.shared} cells were in several databases with the same values")
    if merged.overruled:
        lines.append(f"  {merged.overruled} cells that went wrong in one database are done in another")
    if merged.conflicts:
        lines.append(f"  {len(merged.conflicts)} done cells had different values, resolved by --prefer:")
        lines += ["  " + line for line in merged.conflict_lines()]
    if merged.missing:
        lines += ["Missing:", *merged.missing_lines()]
        lines.append(f"'calcidem run CONFIG --db {out}' computes them.")
    return lines
