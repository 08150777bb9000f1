"""``calcidem import-packing``: disks of another program as a packing's file."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import number_parser
from calcidem.app.cli.terminal import printable


def import_packing_command(
    source: Annotated[Path, typer.Argument(help="LAMMPS data or dump, YADE text export, PFC ball list, or a table.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="CSV file to write.")],
    unit: Annotated[
        str | None, typer.Option(help="Unit of length: m, cm, mm, um or nm; by default the file's.")
    ] = None,
    columns: Annotated[str, typer.Option(help="Names of the columns from the left: x,y,z,radius.")] = "",
    types: Annotated[list[str] | None, typer.Option("--type", help="Only this type; may be repeated.")] = None,
    plane: Annotated[str, typer.Option(help="Axes of the file that become x and y.")] = "xy",
    walls: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            parser=number_parser(-1e12, 1e12, "is no coordinate from -1e12 to 1e12"),
            metavar="LEFT RIGHT FLOOR LID",
            help="Walls in the file's unit and frame; disks beyond are left out. By default the outermost disks touch.",
        ),
    ] = None,
    timestep: Annotated[int | None, typer.Option(min=0, help="Snapshot of a LAMMPS dump; by default the last.")] = None,
) -> None:
    """Read the disks of another program, report on them, and write the file that [packing] takes.

    What the file is, its content tells. Left wall and floor become x = 0 and y = 0.
    """
    from calcidem.app.disks.packing_import import import_packing

    names = tuple(name.strip() for name in columns.split(",")) if columns else ()
    imported = import_packing(
        source, out, unit=unit, columns=names, types=types or (), plane=plane, walls=walls, timestep=timestep
    )
    typer.echo(printable(imported))
    typer.echo(f'Wrote {out}\n\n[packing]\nfile = "{out}"\nwidth = {imported.width!r}')
