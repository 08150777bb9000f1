"""Arguments and options that several commands have."""

import math
from pathlib import Path
from typing import Annotated

import typer

DEFAULT_CONFIGURATION = Path("calcidem.toml")

_HIGHEST_SEED = 2**63 - 1  # as the store has it, which takes a second to import


def parse_positive(text: object) -> float:
    """Finite number above 0: the bounds that Click checks let NaN through."""
    value = _parse_number(text)
    if not 0.0 < value < math.inf:
        raise typer.BadParameter(f"'{text}' is not a number above 0.")
    return value


def _parse_number(text: object) -> float:
    """Number that a text says; NaN for other texts, which no bounds have between them."""
    try:
        return float(str(text))
    except ValueError:
        return math.nan


def _parse_percentage(text: object) -> float:
    """Content in percent."""
    value = _parse_number(text)
    if not 0.0 <= value <= 100.0:  # noqa: PLR2004 - percent; the comparison also refuses NaN
        raise typer.BadParameter(f"'{text}' is no content; give percent of the sand's mass, from 0 to 100.")
    return value


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
    list[float] | None,
    typer.Option("--content", parser=_parse_percentage, metavar="PERCENT", help="Only this content; may be repeated."),
]
OnlySeeds = Annotated[
    list[int] | None, typer.Option("--seed", min=0, max=_HIGHEST_SEED, help="Only this seed; may be repeated.")
]
OneContent = Annotated[
    float, typer.Option("--content", parser=_parse_percentage, metavar="PERCENT", help="Calcite content of the cell.")
]
OneSeed = Annotated[int, typer.Option("--seed", min=0, max=_HIGHEST_SEED, help="Seed of the cell.")]
StudyFolder = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for figure, tables and JSON.")]
StudyAsJson = Annotated[bool, typer.Option("--json", help="Write JSON instead of tables.")]
StudyCores = Annotated[int, typer.Option(min=0, help="Cores to compute on; 0 for all.")]
