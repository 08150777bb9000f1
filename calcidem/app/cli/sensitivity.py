"""``calcidem sensitivity``: how each choice of a campaign changes mean and scatter of Vs."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.studies.sensitivity.plan import load_plan
from calcidem.app.studies.sensitivity.study import compare_variants, compute_variants, sensitivity_table
from calcidem.storage.files import write_text_atomically


def sensitivity_command(
    plan: Annotated[Path, typer.Argument(metavar="PLAN.toml", help="Variants of a configuration.")],
    database: Annotated[str, typer.Option("--db", metavar="FILE", help="Database for all variants.")],
    out: Annotated[Path | None, typer.Option(metavar="TABLE.md", help="File for the table.")] = None,
    only_table: Annotated[bool, typer.Option("--only-table", help="Compute nothing; show what is stored.")] = False,
) -> None:
    """Compute variants of a campaign with the same seeds, and show how each changes mean and scatter of Vs."""
    variants = load_plan(plan, database)
    if not only_table:
        compute_variants(variants, lambda text: typer.echo(text, err=True))
    table = sensitivity_table(variants, compare_variants(variants))
    if out is None:
        typer.echo(table)
    else:
        write_text_atomically(out, table)
        typer.echo(f"Wrote {out}")
