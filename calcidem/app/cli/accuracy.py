"""``calcidem accuracy`` and ``calcidem stability``: error against run time, and extreme cases."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.accuracy.command import Task, accuracy, choose_settings, parse_target
from calcidem.app.studies.stability.command import random_scenes, stability
from calcidem.app.studies.stability.verdict import Verdict
from calcidem.dem.sample.packing import Packing

Folder = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for figure, tables and JSON.")]
AsData = Annotated[bool, typer.Option("--json", help="Write JSON instead of tables.")]


def tell(text: str) -> None:
    """Write what is being done, apart from the result."""
    typer.echo(text, err=True)


def measure_accuracy(
    configuration: Annotated[Path, typer.Argument(metavar="[CONFIG]", help="TOML file of the campaign.")] = Path(
        "calcidem.toml"
    ),
    content: Annotated[
        list[float] | None, typer.Option(help="Only this content, percent; may be repeated. By default all.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="So many seeds of the campaign.")] = 4,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SETTING",
            help="Only the default and this setting, such as 'step_fraction 0.4'; may be repeated.",
        ),
    ] = None,
    target: Annotated[str | None, typer.Option(help="Error of Vs, such as 0.5%: name the cheapest setting.")] = None,
    db: Annotated[
        Path | None, typer.Option(help="Campaign that tells the scatter of the samples; otherwise some are computed.")
    ] = None,
    out: Folder = None,
    as_data: AsData = False,
) -> None:
    """Measure error against run time of every numerical setting, on cells of the campaign."""
    loaded = load_configuration(configuration)
    contents = content or sorted(loaded.campaign.contents)
    task = Task(
        experiment=loaded.experiment(provide_packing(loaded, None, tell)),
        contents=contents,
        seeds=loaded.campaign.seed_numbers[:seeds],
        campaign_hash=loaded.hash,
        campaign_seeds=loaded.campaign.seed_numbers,
        packing_of=lambda balance: balanced(loaded, balance),
        stored=None if db is None else stored_velocities(db, contents),
        lanes=loaded.run.lanes,
    )
    try:
        choose_settings(task.experiment, only or ())
        parse_target(target or "1%")
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    accuracy(task, only=only or (), out=out, json=as_data, target=target, say=typer.echo, progress=tell)


def balanced(configuration: Configuration, balance: float) -> Packing:
    """The campaign's packing, left at another unbalanced-force ratio."""
    changed = replace(configuration, packing=replace(configuration.packing, unbalanced_force_ratio=balance))
    return provide_packing(changed, None, tell)


def stored_velocities(db: Path, contents: Sequence[float]) -> dict[float, list[float]]:
    """Velocities of a stored campaign at some contents, m/s."""
    with open_campaign(db) as campaign:
        vs = campaign.vs()
        known = [value for value in contents if value in vs.content.to_numpy()]
        return {value: vs.sel(content=value).dropna("seed").to_numpy().tolist() for value in known}


def map_stability(
    scenes: Annotated[
        int, typer.Option(min=0, help="Judge so many scenes of each box drawn at random, instead of the maps.")
    ] = 0,
    draw: Annotated[int, typer.Option(min=0, help="Seed of the draw.")] = 1,
    out: Folder = None,
    as_data: AsData = False,
) -> None:
    """Map which small extreme scenes are stable, refused or detected, and check the predicted step limits."""
    if scenes:
        judgements = random_scenes(scenes, draw, json=as_data, say=typer.echo, progress=tell)
        if any(judgement.verdict == Verdict.WRONG for judgement in judgements):
            raise typer.Exit(1)
    else:
        stability(out=out, json=as_data, say=typer.echo, progress=tell)
