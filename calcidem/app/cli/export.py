"""``calcidem export``: a campaign as a NetCDF file or a crate, or one of its samples for other programs."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.cli.arguments import HIGHEST_SEED, CampaignName, Database, parse_percentage
from calcidem.storage.records import ARRAY_RECORDS

_LICENCE = "CC-BY-4.0"
_Array = StrEnum("_Array", list(ARRAY_RECORDS))  # type: ignore[misc]  # not literal


def export_command(
    database: Database,
    out: Annotated[
        Path, typer.Argument(metavar="OUT.nc|.zip|.vtu|.csv", help="File to write or replace; a crate is a zip file.")
    ],
    seed: Annotated[int | None, typer.Option(min=0, max=HIGHEST_SEED, help="Seed of the sample.")] = None,
    content: Annotated[
        float | None, typer.Option(parser=parse_percentage, metavar="PERCENT", help="Its calcite content.")
    ] = None,
    campaign: CampaignName = None,
    without: Annotated[
        list[_Array] | None,
        typer.Option(help="Leave out these arrays, most of the NetCDF file; may be repeated."),
    ] = None,
    crate: Annotated[
        bool,
        typer.Option(
            "--crate", help="Write an RO-Crate: NetCDF file, configuration, packing, report, versions, licence."
        ),
    ] = False,
    licence: Annotated[
        str, typer.Option(metavar="SPDX", help="Licence of the data in the crate, or an address.")
    ] = _LICENCE,
    author: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Author of the data in the crate; may be repeated.")
    ] = None,
) -> None:
    """Write a campaign to a NetCDF file or an RO-Crate, or one sample of it to a file.

    With --seed and --content: the sample with its contacts and cement for ParaView (.vtu), or the disks of its packing
    as CSV (x, y, radius in m).
    """
    if crate:
        if without or seed is not None or content is not None:
            raise typer.BadParameter(
                "a crate is complete: leave out --without, --seed and --content", param_hint="--crate"
            )
        if out.suffix.lower() != ".zip":
            raise typer.BadParameter(f"'{out}' does not end with .zip; a crate is a zip file", param_hint="OUT")
        from calcidem.app.cli.terminal import progress_bar
        from calcidem.app.report.crate import write_crate

        with progress_bar("Report") as watch:
            out = write_crate(database, out, campaign_name=campaign, licence=licence, authors=author or (), watch=watch)
        typer.echo(f"Wrote {out}, licence {licence}")
        return
    if author or licence != _LICENCE:
        raise typer.BadParameter("give --crate, too: other files have neither", param_hint="--licence, --author")
    if seed is None and content is None:
        from calcidem.storage.netcdf.export import export_netcdf
        from calcidem.storage.sql.store import read_campaign

        if out.suffix.lower() in {".zip", ".vtu", ".csv"}:
            needed = ".zip needs --crate, .vtu and .csv need --seed and --content"
            raise typer.BadParameter(f"'{out}' would be a NetCDF file; {needed}", param_hint="OUT")
        with read_campaign(database, campaign) as store:
            export_netcdf(store, out, without=without or ())
    else:
        from calcidem.app.campaign.opened import SUFFIXES, open_campaign

        if seed is None or content is None or without:
            raise typer.BadParameter("one sample has both --seed and --content, and nothing --without")
        if out.suffix.lower() not in SUFFIXES:
            raise typer.BadParameter(f"'{out}' ends with none of {', '.join(SUFFIXES)}", param_hint="OUT")
        with open_campaign(database, campaign) as opened:
            opened.sample(seed=seed, content=content).write(out)
    typer.echo(f"Wrote {out}")
