"""``calcidem sensitivity``: dependence of Vs on the choices of a campaign, its frequency and its damping."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.campaign.notices import tell
from calcidem.app.cli.arguments import CampaignName, OnlyContents, StudyCores, refuse_options
from calcidem.sweep.ranks import available_cores


def sensitivity_command(
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN.toml|frequency|damping",
            help="Variants of a configuration, or the quantity to vary.",
        ),
    ],
    database: Annotated[
        str,
        typer.Option(
            "--db",
            metavar="DB",
            help="Database for all variants; frequency, damping: that of the campaign.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="TABLE.md", help="File for the table; figures and NetCDF beside it."),
    ] = None,
    content: OnlyContents = None,
    campaign: CampaignName = None,
    only_table: Annotated[bool, typer.Option("--only-table", help="Compute nothing; show what is stored.")] = False,
    cores: StudyCores = 0,
) -> None:
    """Compute variants of a campaign with the same seeds, and show how each changes mean and scatter of Vs.

    'frequency' or 'damping' instead of a plan computes samples of a stored campaign with other values; its database is
    not written.
    """
    from calcidem.app.studies.campaigns import study_workers
    from calcidem.app.studies.frequency_and_damping import vary_one
    from calcidem.app.studies.variants import compute_variants, read_variants, variant_table
    from calcidem.storage.files import refuse_to_replace

    if out is not None:
        refuse_to_replace(out)
    if str(plan) in {"frequency", "damping"}:
        refuse_options("leave it out: it is for a plan", {"--only-table": only_table, "--cores": cores or None})
        result = vary_one(str(plan), database, content, campaign)
    else:
        refuse_options("leave it out: the plan has it", {"--content": content, "--campaign": campaign})
        variants = read_variants(plan, database)
        if not only_table:
            with study_workers(cores or available_cores()) as executor:
                compute_variants(variants, tell, executor)
        result = variant_table(variants)
    if out is None:
        typer.echo(result.text)
        return
    for written in result.write(out):
        typer.echo(f"Wrote {written}")
