"""``calcidem sensitivity``: dependence of Vs on the choices of a campaign, its frequency and its damping."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calcidem.app.cli.arguments import CampaignName, OnlyContents, StudyCores, refuse_options
from calcidem.app.cli.terminal import tell
from calcidem.sweep.environment import available_cores

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.studies.results import StudyResult


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
    from calcidem.app.studies.frequency_and_damping import vary_one
    from calcidem.storage.files import refuse_to_replace

    if out is not None:
        refuse_to_replace(out)
    if str(plan) in {"frequency", "damping"}:
        refuse_options("leave it out: it is for a plan", {"--sobol": sobol, "--only-table": only_table})
        result = vary_one(str(plan), database, content, campaign)
    else:
        refuse_options("leave it out: the plan has it", {"--content": content, "--campaign": campaign})
        result = _study_of_plan(plan, database, sobol, only_table=only_table, cores=cores)
    if out is None:
        typer.echo(result.text)
        return
    for written in result.write(out):
        typer.echo(f"Wrote {written}")


def _study_of_plan(plan: Path, database: str, sobol: int | None, *, only_table: bool, cores: int) -> "StudyResult":
    """Compute the variants of a plan, or its Sobol points."""
    from calcidem.app.campaign.packing import provide_packing
    from calcidem.app.studies.sensitivity.plan import VariantPlan
    from calcidem.app.studies.sensitivity.sobol import SobolPlan

    if sobol is None:
        variants = VariantPlan.load(plan, database)
        if not only_table:
            variants.compute(tell)
        return variants.result()
    ranges, file = SobolPlan.load(plan, sobol), Path(database)
    if only_table:
        return ranges.result(ranges.stored(file))
    packing = provide_packing(ranges.configuration, None, tell)
    return ranges.result(ranges.evaluate(packing, file, cores or available_cores(), tell))
