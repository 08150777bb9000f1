"""``calcidem plan``: how many more seeds a mean needs, and how long they take."""

from typing import Annotated

import numpy as np
import typer

from calcidem.app.cli.arguments import CampaignName, Database, OneContent, number_parser
from calcidem.storage.errors import QueryError
from calcidem.storage.records import CellStatus
from calcidem.storage.store import Selection

_FEWEST = 3
"""Cells below which a standard deviation says nothing."""

_WITHOUT_VELOCITY = (CellStatus.NO_ARRIVAL, CellStatus.UNSTABLE)
"""Outcomes that a seed has by itself; as many of the seeds to come will have them."""


def plan_command(
    database: Database,
    content: OneContent,
    half_width: Annotated[
        float,
        typer.Option(
            "--halfwidth",
            parser=number_parser(1e-6, 1e6, "is not a number above 0, from 1e-6 to 1e6"),
            metavar="M/S",
            help="Wanted half-width of the 95 % interval of the mean.",
        ),
    ],
    campaign: CampaignName = None,
) -> None:
    """Estimate how many more seeds bring the mean of Vs at a content to a given interval, and how long they take."""
    from calcidem.analysis.planning import plan_seeds
    from calcidem.storage.sql.store import read_campaign

    with read_campaign(database, campaign) as store:
        columns = store.table(("vs", "status", "seconds"), Selection(contents=(content,)))
    vs = columns["vs"].astype(float)
    vs = vs[np.isfinite(vs)]
    if len(vs) < _FEWEST:
        raise QueryError(
            f"{len(vs)} cells at {content:g} % have a velocity.", f"Compute at least {_FEWEST} seeds first."
        )
    unreadable = sum(status in _WITHOUT_VELOCITY for status in columns["status"])
    planned = plan_seeds(vs, half_width, unreadable=unreadable)
    seconds = planned.more * float(np.nanmean(columns["seconds"].astype(float)))
    typer.echo(
        f"{content:g} %: {planned.present} seeds give a mean of "
        f"{vs.mean():.1f} m/s +- {planned.present_half_width:.1f} m/s"
        + (f"; {unreadable} more gave no velocity." if unreadable else ".")
    )
    typer.echo(
        f"+- {half_width:g} m/s needs {planned.needed} seeds with a velocity "
        f"({planned.needed_low} to {planned.needed_high}, since the scatter itself is uncertain): "
        f"{planned.more} more, about {seconds:.0f} s on one core for this content."
    )
