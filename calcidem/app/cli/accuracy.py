"""``calcidem accuracy``: error against run time."""

from typing import Annotated

import typer

from calcidem.app.campaign.notices import tell
from calcidem.app.cli.arguments import (
    DEFAULT_CONFIGURATION,
    SEEDS_AT_ONCE,
    ConfigurationFile,
    JudgedDatabase,
    OnlyContents,
    StudyFolder,
)
from calcidem.app.cli.formats import Format, FormatOption, tell_study


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
    """Measure error against run time of every numerical setting, on cells of the campaign.

    A table has what the computation leaves out, why that is safe, and what it would cost.
    """
    from calcidem.app.config.reader import change_configuration, load_configuration
    from calcidem.app.studies.accuracy.report import accuracy, choose_settings, parse_target
    from calcidem.app.studies.cells import Cells
    from calcidem.app.studies.results import StudyResult

    loaded = load_configuration(configuration)
    planned = change_configuration(loaded, {"campaign.contents": sorted(set(content or loaded.campaign.contents))})
    cells, velocities = Cells.of_campaign(planned, seeds, db, tell)
    try:
        choose_settings(cells, only or ())
        parse_target(target or "1%")
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    table = out and out / "accuracy.md"

    def write(part: StudyResult) -> None:
        if table is not None:
            list(part.write(table))

    result = accuracy(planned, cells, velocities, only=only or (), target=target, tell=write)
    tell_study(result, layout, table)
