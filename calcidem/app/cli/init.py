"""``calcidem init``: an example configuration."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import DEFAULT_CONFIGURATION
from calcidem.app.config.presets import PRESETS, preset_text

Preset = StrEnum("Preset", {name.replace("-", "_").upper(): name for name in PRESETS})  # type: ignore[misc]  # not literal
_FIRST = next(iter(Preset))


def init_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write.")] = DEFAULT_CONFIGURATION,
    preset: Annotated[
        Preset,
        typer.Option(
            help="quick: 6 contents x 4 seeds; paper: all 17 x 116, the printed pulse of 5 m/s; paper-small-pulse: the "
            "same with 1 mm/s, linear and faster; paper-literal: Table 1 as printed; paper-locked: stress of "
            "preparation locked in, nothing calibrated."
        ),
    ] = _FIRST,
    full: Annotated[
        bool, typer.Option("--full", help="Include every key, with its meaning and the values it takes.")
    ] = False,
) -> None:
    """Write an example configuration to start from."""
    text = preset_text(preset)
    if full:
        from calcidem.app.config.reference import full_text  # the reader of configurations takes a second to load

        text = full_text(preset)
    try:
        with file.open("x", encoding="utf-8") as target:
            target.write(text)
    except FileExistsError:
        if not file.is_file():
            raise typer.BadParameter(f"{file} is a folder or a device; give the name of a file") from None
        other = file.with_stem(f"{file.stem}-{preset}")
        problem = f"{file} is there already and stays as it is; run it with 'calcidem run {file}', or write another "
        raise typer.BadParameter(f"{problem}with 'calcidem init {other} --preset {preset}'") from None
    typer.echo(f"Wrote {file}. Edit it as you like, then: calcidem run {file}")
