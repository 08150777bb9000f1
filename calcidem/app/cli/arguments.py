"""Arguments and options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

DEFAULT_CONFIGURATION = Path("calcidem.toml")

ConfigurationFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="TOML file of the campaign.")]
Database = Annotated[str, typer.Argument(metavar="DB", help="SQLite file or database URL.")]
CampaignName = Annotated[
    str | None, typer.Option("--campaign", metavar="NAME", help="Which campaign, if the database has several.")
]
JudgedDatabase = Annotated[
    str | None,
    typer.Option(
        "--db",
        metavar="DB",
        help="SQLite file or database URL of this campaign: its own packing is taken; otherwise one is made.",
    ),
]
OnlyContents = Annotated[
    list[float] | None, typer.Option("--content", help="Only this content, percent; may be repeated.")
]
OnlySeeds = Annotated[list[int] | None, typer.Option("--seed", help="Only this seed; may be repeated.")]
StudyFolder = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for figure, tables and JSON.")]
StudyAsJson = Annotated[bool, typer.Option("--json", help="Write JSON instead of tables.")]
