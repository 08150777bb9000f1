"""``calcidem plan``: how many more seeds a mean needs, and how long they take."""

from typing import Annotated

import numpy as np
import typer

from calcidem.analysis.planning import plan_seeds
from calcidem.storage.campaign import open_stored_campaign
from calcidem.storage.errors import QueryError
from calcidem.storage.store import Selection

LEAST = 3
"""Cells below which a standard deviation says nothing."""


def plan(
    database: Annotated[str, typer.Argument(metavar="DB", help="SQLite file or database URL.")],
    content: Annotated[float, typer.Option(help="Content that is asked about, percent.")],
    half_width: Annotated[
        float, typer.Option("--halfwidth", min=0.0, help="Half of the 95 % interval of the mean that is wanted, m/s.")
    ],
    campaign: Annotated[str | None, typer.Option("--campaign", help="Which one, if the database has several.")] = None,
) -> None:
    """Tell how many more seeds narrow the mean of Vs at a content to an interval, and what they cost."""
    with open_stored_campaign(database, campaign) as opened:
        columns = opened.store.table(("vs", "seconds"), Selection(contents=(content,)))
    vs = columns["vs"].astype(float)
    vs = vs[np.isfinite(vs)]
    if len(vs) < LEAST:
        raise QueryError(f"{len(vs)} cells at {content:g} % have a velocity.", f"Compute at least {LEAST} seeds first.")
    planned = plan_seeds(vs, half_width)
    seconds = planned.more * float(np.nanmean(columns["seconds"].astype(float)))
    typer.echo(
        f"{content:g} %: {planned.present} seeds give the mean "
        f"{vs.mean():.1f} m/s +- {planned.present_half_width:.1f} m/s."
    )
    typer.echo(
        f"+- {half_width:g} m/s need {planned.needed} seeds "
        f"({planned.needed_low} to {planned.needed_high} with the uncertainty of the scatter): "
        f"{planned.more} more, about {seconds:.0f} s of one core for this content."
    )
