"""``calcidem sensitivity``: how the choices of a campaign change mean and scatter of Vs, one by one or together."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calcidem.app.cli.arguments import StudyCores
from calcidem.sweep.environment import available_cores

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.studies.sensitivity.sobol import SobolPlan


def sensitivity_command(
    plan: Annotated[Path, typer.Argument(metavar="PLAN.toml", help="Variants or ranges of a configuration.")],
    database: Annotated[
        str,
        typer.Option("--db", metavar="DB", help="Database for all variants; with --sobol a NetCDF file of points."),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="TABLE.md", help="File for the table, and beside it the figure of --sobol.")
    ] = None,
    only_table: Annotated[bool, typer.Option("--only-table", help="Compute nothing; show what is stored.")] = False,
    sobol: Annotated[
        int | None,
        typer.Option(
            min=2,
            max=2**20,
            metavar="N",
            help="Vary all \\[ranges] of the plan together: first and total Sobol indices of mean, sd / mean and "
            "readable share, from N base points (a power of two), which are N (parameters + 2) campaigns.",
        ),
    ] = None,
    cores: StudyCores = 0,
) -> None:
    r"""Compute variants of a campaign with the same seeds, and show how each changes mean and scatter of Vs.

    With --sobol the numbers in the plan's \[ranges] are varied all together, and shares of the variance are shown.
    """
    from calcidem.app.cli.tables import tell
    from calcidem.app.studies.sensitivity.plan import load_plan
    from calcidem.app.studies.sensitivity.sobol import load_sobol_plan
    from calcidem.app.studies.sensitivity.study import compare_variants, compute_variants, sensitivity_table
    from calcidem.storage.files import refuse_to_replace, write_text_atomically

    if out is not None:
        refuse_to_replace(out)
    if sobol is None:
        variants = load_plan(plan, database)
        if not only_table:
            compute_variants(variants, tell)
        table = sensitivity_table(variants, compare_variants(variants))
    else:
        table = _sobol_study(
            load_sobol_plan(plan, sobol), Path(database), out, 0 if only_table else cores or available_cores()
        )
    if out is None:
        typer.echo(table)
    else:
        write_text_atomically(out, table)
        typer.echo(f"Wrote {out}")


def _sobol_study(plan: "SobolPlan", file: Path, out: Path | None, cores: int) -> str:
    """Table of Sobol indices, of what is stored if there are no cores to compute on; the figure goes beside ``out``."""
    from calcidem.analysis.figures.sensitivity import draw_sobol
    from calcidem.analysis.figures.style import save
    from calcidem.app.campaign.packing import provide_packing
    from calcidem.app.cli.tables import tell
    from calcidem.app.studies.sensitivity.sobol import evaluate_points, indices_of_points, sobol_table, stored_points

    if cores:
        packing = provide_packing(plan.configuration, None, tell)
        points = evaluate_points(plan, packing, file, cores, tell)
    else:
        points = stored_points(plan, file)
    indices = indices_of_points(plan, points)
    if out is not None:
        for written in save(draw_sobol(indices), out.parent, out.stem, ("png",)):
            typer.echo(f"Wrote {written}")
    return sobol_table(indices)
