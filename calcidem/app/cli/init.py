"""``calcidem init``: an example configuration."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import DEFAULT_CONFIGURATION, refuse_options
from calcidem.app.config.presets import PRESETS, preset_text, slurm_job

Preset = StrEnum("Preset", {name.replace("-", "_").upper(): name for name in PRESETS})  # type: ignore[misc]  # not literal


def init_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write.")] = DEFAULT_CONFIGURATION,
    preset: Annotated[
        Preset | None,
        typer.Option(
            help="quick (default): 6 contents x 4 seeds; paper: 17 x 116; both with a quiet pulse; paper-as-printed: "
            "the same with the printed pulse of 5 m/s, on which its velocities depend."
        ),
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="Include every key with its meaning.")] = False,
    grain_size: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="Mean diameter of your own sand, such as 0.3mm; or d10,d50,d90 by mass, such as 0.2mm,0.3mm,0.4mm.",
        ),
    ] = None,
    grading: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Or its grading: a table of size (with unit) and percent finer by mass."),
    ] = None,
    disks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv", help="Or its disks: columns x, y and radius in m, as 'calcidem import' writes."
        ),
    ] = None,
    stress: Annotated[
        str | None,
        typer.Option(metavar="STRESS", help="Its confining stress; 100kPa if not given."),
    ] = None,
    mineral: Annotated[
        str | None,
        typer.Option(
            metavar="MINERAL",
            help="Its grains: quartz (if not given), carbonate, calcite or glass; or shear modulus, Poisson's ratio "
            "and density, such as 30GPa,0.2,2500kg/m3.",
        ),
    ] = None,
    contents: Annotated[
        str | None, typer.Option(metavar="PERCENT,...", help="Its calcite contents; 0,1,2,4 if not given.")
    ] = None,
    slurm: Annotated[
        bool,
        typer.Option("--slurm", help="Also write its Slurm job, FILE.sbatch; a configuration that exists is kept."),
    ] = False,
) -> None:
    """Write a configuration to start from: an example, or one for your own sand."""
    if not file.name:
        raise typer.BadParameter(f"{file} is a folder or a device; give the name of a file")
    chosen = preset or next(iter(Preset))
    sizes = {"--grain-size": grain_size, "--grading": grading, "--disks": disks}
    given = [name for name, value in sizes.items() if value is not None]
    if not given:
        of_a_sand = {"--stress": stress, "--mineral": mineral, "--contents": contents}
        refuse_options("give --grain-size, --grading or --disks, too: it is for a sand of your own", of_a_sand)
        text = preset_text(chosen)
        if full:
            from calcidem.app.config.reference import full_text  # the reader of configurations takes a second to load

            text = full_text(chosen)
    elif preset is not None or full:
        raise typer.BadParameter("leave --preset and --full out: they are for examples", param_hint=given[0])
    elif len(given) > 1:
        said = "the disks have their sizes" if disks is not None else "the grading has it"
        raise typer.BadParameter(f"leave it out: {said}", param_hint=given[0])
    else:
        from calcidem.app.config.own_sand import OwnSand, read_grading  # as above

        size = disks or grain_size or ",".join(f"{d!r}m" for d in read_grading(grading or Path()))
        own = OwnSand.of_words(size, stress or "100kPa", mineral or "quartz", contents or "0,1,2,4", file.parent)
        text = own.text()
    if slurm:
        job = file.with_suffix(".sbatch")
        _write_new(job, slurm_job(file.name), "submit it, or remove it first")
        typer.echo(f"Wrote {job}. Edit its first lines, then: sbatch {job}")
        if file.exists():
            return
    other = file.with_stem(f"{file.stem}-{chosen}")
    another = "give another name" if given else f"write another with 'calcidem init {other} --preset {chosen}'"
    _write_new(file, text, f"run it with 'calcidem run {file}', or {another}")
    typer.echo(f"Wrote {file}. Edit it as you like, then: calcidem run {file}")


def _write_new(file: Path, text: str, remedy: str) -> None:
    """Write a file that must not exist yet."""
    try:
        with file.open("x", encoding="utf-8") as target:
            target.write(text)
    except FileExistsError:
        if not file.is_file():
            raise typer.BadParameter(f"{file} is a folder or a device; give the name of a file") from None
        raise typer.BadParameter(f"{file} exists and was left unchanged; {remedy}") from None
