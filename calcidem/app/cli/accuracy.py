"""``calcidem accuracy``: error against run time."""

import json
from typing import Annotated

import typer

from calcidem.app.cli.arguments import (
    DEFAULT_CONFIGURATION,
    SEEDS_AT_ONCE,
    ConfigurationFile,
    JudgedDatabase,
    OnlyContents,
    StudyFolder,
)
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.app.cli.terminal import tell


def accuracy_command(
    configuration: ConfigurationFile = DEFAULT_CONFIGURATION,
    content: OnlyContents = None,
    seeds: Annotated[int, typer.Option(min=1, max=SEEDS_AT_ONCE, help="Number of seeds to measure.")] = 4,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SETTING",
            help="Only this setting beside the default, such as 'step_fraction 0.4'; may be repeated.",
        ),
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Also name the cheapest setting with this error of Vs, such as 0.5%.")
    ] = None,
    db: JudgedDatabase = None,
    out: StudyFolder = None,
    layout: FormatOption = Format.TABLE,
) -> None:
    """Measure error against run time of every numerical setting, on cells of the campaign."""
    from calcidem.app.config.reader import change_configuration, load_configuration
    from calcidem.app.studies.accuracy.command import AccuracyTask, parse_target
    from calcidem.app.studies.accuracy.report import accuracy_tables

    loaded = load_configuration(configuration)
    planned = {"campaign.contents": sorted(set(content or loaded.campaign.contents))}
    task = AccuracyTask.plan(change_configuration(loaded, planned), (), seeds, db, tell)
    try:
        task.choose_settings(only or ())
        parse_target(target or "1%")
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    findings = task.measure(only=only or (), out=out, progress=tell)
    if layout is Format.TABLE:
        typer.echo("\n\n".join(accuracy_tables(findings).values()))
        if target is not None:
            chosen = findings.study.cheapest_in_words(parse_target(target))
            typer.echo(f"Cheapest setting with an error of at most {target}: {chosen}")
    else:
        whole = json.loads(findings.as_json())
        tell_rows(whole["study"]["cells"], layout, whole=whole)
