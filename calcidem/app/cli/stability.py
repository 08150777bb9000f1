"""``calcidem stability``: extreme cases."""

from typing import Annotated

import typer

from calcidem.app.cli.arguments import StudyFolder
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.app.cli.terminal import tell


def stability_command(
    scenes: Annotated[int, typer.Option(min=0, help="Random scenes of each box, instead of the maps.")] = 0,
    draw: Annotated[int, typer.Option(min=0, metavar="SEED", help="Seed of the random scenes.")] = 1,
    out: StudyFolder = None,
    layout: FormatOption = Format.TABLE,
) -> None:
    """Map which small extreme scenes are stable, refused or detected, and check the predicted step limits."""
    from calcidem.app.studies.stability.command import StabilityVerdict, random_scenes, stability

    if scenes:
        text, whole = random_scenes(scenes, draw, progress=tell)
        rows = [{"box": box, **judgement} for box, row in whole.items() for judgement in row]
    else:
        text, whole = stability(out=out, progress=tell)
        rows = [{"quantity": name, **judgement} for name, walk in whole["walks"].items() for judgement in walk]
    if layout is Format.TABLE:
        typer.echo(text)
    else:
        tell_rows(rows, layout, whole=whole)
    if scenes and any(row["verdict"] == StabilityVerdict.WRONG for row in rows):
        raise typer.Exit(1)
