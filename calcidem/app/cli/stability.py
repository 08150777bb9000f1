"""``calcidem stability``: extreme cases."""

from typing import Annotated

import typer

from calcidem.app.cli.arguments import StudyFolder
from calcidem.app.cli.formats import Format, FormatOption, tell_study
from calcidem.app.cli.terminal import tell
from calcidem.sweep.sweep_end import EXIT_ERROR


def stability_command(
    scenes: Annotated[int, typer.Option(min=0, help="Random scenes of each box, instead of the maps.")] = 0,
    draw: Annotated[int, typer.Option(min=0, metavar="SEED", help="Seed of the random scenes.")] = 1,
    out: StudyFolder = None,
    layout: FormatOption = Format.TABLE,
) -> None:
    """Map which small extreme scenes are stable, refused or detected, and check the predicted step limits."""
    from calcidem.app.studies.stability.command import random_scenes, stability

    result = random_scenes(scenes, draw, tell) if scenes else stability(tell)
    tell_study(result, layout, out and out / "stability.md")
    if result.is_wrong:
        raise typer.Exit(EXIT_ERROR)
