"""``calcidem sample``: one sample for ParaView, or its packing as CSV."""

from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import CampaignName, Database, OneContent, OneSeed


def sample_command(
    database: Database,
    out: Annotated[Path, typer.Argument(help="File to write; its ending decides: .vtu or .csv.")],
    seed: OneSeed,
    content: OneContent,
    campaign: CampaignName = None,
) -> None:
    """Write one sample for ParaView (.vtu), or the disks of its packing as CSV (x, y, radius in m)."""
    from calcidem.app.campaign.opened import SUFFIXES, open_campaign, write_sample

    if out.suffix.lower() not in SUFFIXES:
        raise typer.BadParameter(f"'{out}' ends with none of {', '.join(SUFFIXES)}", param_hint="OUT")
    with open_campaign(database, campaign) as opened:
        write_sample(opened.sample(seed=seed, content=content), out)
    typer.echo(f"Wrote {out}")
