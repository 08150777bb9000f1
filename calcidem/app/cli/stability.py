"""``calcidem stability``: extreme cases."""

from typing import Annotated

import typer

from calcidem.app.cli.arguments import StudyAsJson, StudyFolder


def stability_command(
    scenes: Annotated[
        int, typer.Option(min=0, help="Judge this many random scenes of each box instead of the maps.")
    ] = 0,
    draw: Annotated[int, typer.Option(min=0, metavar="SEED", help="Seed of the random scenes.")] = 1,
    out: StudyFolder = None,
    as_json: StudyAsJson = False,
) -> None:
    """Map which small extreme scenes are stable, refused or detected, and check the predicted step limits."""
    from calcidem.app.cli.tables import tell
    from calcidem.app.studies.stability.command import random_scenes, stability
    from calcidem.app.studies.stability.verdict import StabilityVerdict

    if scenes:
        judgements = random_scenes(scenes, draw, json=as_json, say=typer.echo, progress=tell)
        if any(judgement.verdict == StabilityVerdict.WRONG for judgement in judgements):
            raise typer.Exit(1)
    else:
        stability(out=out, json=as_json, say=typer.echo, progress=tell)
