"""``calcidem sensitivity``: how Vs depends on the choices of a campaign, its frequency and its damping."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calcidem.app.cli.arguments import CampaignName, OnlyContents, StudyCores
from calcidem.app.cli.terminal import tell
from calcidem.sweep.environment import available_cores

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.studies.sensitivity.sobol import SobolPlan


def sensitivity_command(
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN.toml|frequency|damping",
            help="Variants or ranges of a configuration, or the quantity to vary.",
        ),
    ],
    database: Annotated[
        str,
        typer.Option(
            "--db",
            metavar="DB",
            help="Database for all variants; --sobol: NetCDF file of points; frequency, damping: the campaign's.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="TABLE.md", help="File for the table; figures and NetCDF beside it."),
    ] = None,
    content: OnlyContents = None,
    campaign: CampaignName = None,
    only_table: Annotated[bool, typer.Option("--only-table", help="Compute nothing; show what is stored.")] = False,
    sobol: Annotated[
        int | None,
        typer.Option(
            min=2,
            max=2**20,
            metavar="N",
            help="Sobol indices of all \\[ranges] from N base points, a power of two: N (parameters + 2) campaigns.",
        ),
    ] = None,
    cores: StudyCores = 0,
) -> None:
    r"""Compute variants of a campaign with the same seeds, and show how each changes mean and scatter of Vs.

    --sobol varies all \[ranges] of the plan together and shows shares of the variance. 'frequency' or 'damping' instead
    of a plan computes samples of a stored campaign with other values; its database is not written.
    """
    from calcidem.app.studies.sensitivity.plan import VariantPlan
    from calcidem.app.studies.sensitivity.sobol import SobolPlan
    from calcidem.storage.files import refuse_to_replace, write_text_atomically

    if out is not None:
        refuse_to_replace(out)
    if str(plan) in {"frequency", "damping"}:
        table = _vary_one(str(plan), database, content, campaign, out)
    elif sobol is None:
        variants = VariantPlan.load(plan, database)
        if not only_table:
            variants.compute(tell)
        table = variants.table()
    else:
        table = _sobol_study(
            SobolPlan.load(plan, sobol), Path(database), out, 0 if only_table else cores or available_cores()
        )
    if out is None:
        typer.echo(table)
    else:
        write_text_atomically(out, table)
        typer.echo(f"Wrote {out}")


def _vary_one(name: str, database: str, contents: list[float] | None, campaign: str | None, out: Path | None) -> str:
    """Table of mean Vs against frequency or damping on samples of a campaign; figures and numbers go beside ``out``."""
    from calcidem.analysis.figures.sensitivity import STUDY_FIGURES
    from calcidem.analysis.figures.style import save
    from calcidem.app.studies.frequency_and_damping import run_studies, study_table
    from calcidem.storage.netcdf.export import write_netcdf

    found = run_studies(database, [name], contents=contents, campaign_name=campaign)[name]
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_netcdf(found, out.with_suffix(".nc"))
        typer.echo(f"Wrote {out.with_suffix('.nc')}")
        for entry in (entry for entry in STUDY_FIGURES if entry.study == name):
            for file in save(entry.draw(found), out.parent, entry.name):
                typer.echo(f"Wrote {file}")
    return study_table(found, name)


def _sobol_study(plan: "SobolPlan", file: Path, out: Path | None, cores: int) -> str:
    """Table of Sobol indices, of what is stored if there are no cores to compute on; the figure goes beside ``out``."""
    from calcidem.analysis.figures.sensitivity import draw_sobol
    from calcidem.analysis.figures.style import save
    from calcidem.app.campaign.packing import provide_packing
    from calcidem.app.studies.sensitivity.sobol import sobol_table

    if cores:
        packing = provide_packing(plan.configuration, None, tell)
        points = plan.evaluate(packing, file, cores, tell)
    else:
        points = plan.stored(file)
    indices = plan.indices(points)
    if out is not None:
        for written in save(draw_sobol(indices), out.parent, out.stem, ("png",)):
            typer.echo(f"Wrote {written}")
    return sobol_table(indices)
