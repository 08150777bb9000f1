"""``calcidem init``: an example configuration."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import DEFAULT_CONFIGURATION
from calcidem.app.config.presets import preset_text


class Preset(StrEnum):
    """Example configurations that come with calcidem."""

    QUICK = "quick"
    PAPER = "paper"
    PAPER_LITERAL = "paper-literal"
    PAPER_LOCKED = "paper-locked"


def init_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write.")] = DEFAULT_CONFIGURATION,
    preset: Annotated[
        Preset,
        typer.Option(
            help="quick: 6 contents x 4 seeds; paper: all 17 x 116; paper-literal: Table 1 as printed; "
            "paper-locked: stress of preparation locked in, nothing calibrated."
        ),
    ] = Preset.QUICK,
) -> None:
    """Write an example configuration to start from."""
    with file.open("x", encoding="utf-8") as target:
        target.write(preset_text(preset))
    typer.echo(f"Wrote {file}. Edit it as you like, then: calcidem run {file}")
