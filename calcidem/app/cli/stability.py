"""``calcidem stability``: extreme cases."""

from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.campaign.notices import tell
from calcidem.app.cli.arguments import JudgedDatabase, StudyFolder, parse_percentage
from calcidem.app.cli.formats import Format, FormatOption, tell_study
from calcidem.sweep.schedule import EXIT_ERROR


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
    scenes: Annotated[int, typer.Option(min=0, help="Random scenes, instead of one quantity at a time.")] = 0,
    draw: Annotated[int, typer.Option(min=0, metavar="SEED", help="Seed of the random scenes.")] = 1,
    db: JudgedDatabase = None,
    out: StudyFolder = None,
    layout: FormatOption = Format.TABLE,
) -> None:
    """Show which extreme values of step, bonds, damping, pulse and content are stable, refused or stopped.

    Exit code 1 if a velocity is silently wrong.
    """
    from calcidem.app.config.reader import load_configuration
    from calcidem.app.studies.cells import Cells
    from calcidem.app.studies.stability import stability

    with as_file(files("calcidem.app.config.presets") / "quick.toml") as quick:
        loaded = load_configuration(configuration or quick)
    cells, _ = Cells.of_campaign(loaded, 1, db, tell)
    middle = cells.contents[len(cells.contents) // 2]
    chosen = middle if content is None else content
    result = stability(loaded, cells.experiment, chosen, scenes=scenes, draw=draw, progress=tell)
    tell_study(result, layout, out and out / "stability.md")
    if result.is_wrong:
        raise typer.Exit(EXIT_ERROR)
