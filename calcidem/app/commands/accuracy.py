"""``calcidem accuracy`` and ``calcidem stability``: error against run time, and extreme cases."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.accuracy.command import accuracy
from calcidem.app.configuration_file import load_configuration
from calcidem.app.packing_source import provide_packing
from calcidem.app.stability.command import stability

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
    target: Annotated[str | None, typer.Option(help="Error of Vs, such as 0.5%: name the cheapest setting.")] = None,
    out: Folder = None,
    as_data: AsData = False,
) -> None:
    """Measure error against run time of every numerical setting, on cells of the campaign."""
    loaded = load_configuration(configuration)
    packing = provide_packing(loaded, None, tell)
    accuracy(
        loaded.experiment(packing),
        content or sorted(loaded.campaign.contents),
        loaded.campaign.seed_numbers[:seeds],
        out=out,
        json=as_data,
        target=target,
        say=typer.echo,
        progress=tell,
    )


def map_stability(out: Folder = None, as_data: AsData = False) -> None:
    """Map which small extreme scenes are stable, refused or detected, and check the predicted step limits."""
    stability(out=out, json=as_data, say=typer.echo, progress=tell)
