"""Arguments and options that several commands have, and notices on a terminal. Imports no large library."""

import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any

import typer

from calcidem.sweep.ranks import launcher
from calcidem.wording import printable

IS_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)
"""Whether only results and errors are written; each command sets it."""

IS_VERBOSE: ContextVar[bool] = ContextVar("verbose", default=False)
"""Whether tracebacks of errors and the time of a command are wanted, too."""


def say(text: object, *, err: bool = False) -> None:
    """Write a text for people, printable, to standard output or error; a terminal breaks its lines between words."""
    lines = printable(text).split("\n")
    if (sys.stderr if err else sys.stdout).isatty() and launcher() is None:
        width = shutil.get_terminal_size().columns
        lines = [
            textwrap.fill(
                line,
                width,
                subsequent_indent=line[: len(line) - len(line.lstrip())],
                break_long_words=False,
                break_on_hyphens=False,
            )
            for line in lines
        ]
    typer.echo("\n".join(lines), err=err)


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Return a function that receives the numbers of finished and of all parts, for a bar on a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=IS_QUIET.get() or not console.is_terminal) as progress:
        task = progress.add_task(title)
        yield lambda done, total: progress.update(task, completed=done, total=total)


DEFAULT_CONFIGURATION = Path("calcidem.toml")

HIGHEST_SEED = 2**63 - 1  # as the store has it, which takes a second to import
SEEDS_AT_ONCE = 1_000_000  # at most, as in a configuration


def number_parser(low: float, high: float, refusal: str) -> Callable[[object], float]:
    """Give a parser of numbers between bounds: those that Click checks let NaN through.

    Parameters
    ----------
    low, high
        Finite.
    refusal
        Text of the refusal, after the value itself.
    """

    def parse(text: object) -> float:
        try:
            value = float(str(text))
        except ValueError:
            value = math.nan
        if not low <= value <= high:  # which also refuses NaN
            raise typer.BadParameter(f"'{text}' {refusal}.")
        return value

    return parse


def refuse_options(reason: str, given: Mapping[str, object]) -> None:
    """Raise `typer.BadParameter` for options, by their names, that would have no effect: all but None, False, empty."""
    names = [
        name for name, value in given.items() if value is not None and value is not False and value not in ("", [])
    ]
    if names:
        raise typer.BadParameter(reason, param_hint=", ".join(names))


def percent_option(words: str, *names: str) -> Any:  # noqa: ANN401 - as typer's own
    """Option for one calcite content, or several, with its help; the name is that of the parameter unless given."""
    refusal = "is not a content; give percent of the sand's mass, from 0 to 100"
    return typer.Option(*names, parser=number_parser(0.0, 100.0, refusal), metavar="PERCENT", help=words)


ConfigurationFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="TOML file of the campaign.")]
Database = Annotated[str, typer.Argument(metavar="DB", help="SQLite file or database URL.")]
CampaignName = Annotated[
    str | None, typer.Option("--campaign", metavar="NAME", help="Campaign of a database that has several.")
]
JudgedDatabase = Annotated[
    str | None, typer.Option("--db", metavar="DB", help="Take the packing of this campaign's database.")
]
OnlyContents = Annotated[
    list[float] | None,
    percent_option("Only this content (repeatable).", "--content"),
]
OnlySeeds = Annotated[
    list[int] | None, typer.Option("--seed", min=0, max=HIGHEST_SEED, help="Only this seed (repeatable).")
]
Level = Annotated[
    float,
    typer.Option(
        parser=number_parser(0.5, 0.999, "is not a probability from 0.5 to 0.999"),  # no campaign has samples for more
        help="Probability of the intervals.",
    ),
]
StudyFolder = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for figure, tables and JSON.")]
StudyCores = Annotated[int, typer.Option(min=0, help="Cores to compute on; 0 for all.")]
