"""``calcidem doctor``: checks of this machine for a campaign, one finding per line."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.text import Text

from calcidem.app.cli.formats import Format, FormatOption, tell_rows

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.doctor.checkup import Finding

_STYLES = {"ok": "green", "warning": "yellow", "problem": "bold red"}
"""Of the levels of a finding."""


def doctor_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the database.")] = Path(),
    layout: FormatOption = Format.TABLE,
) -> None:
    """Check what a campaign needs here: MPI, cores, disk, caches and Slurm; propose remedies.

    It starts two ranks and writes a small database. Exit code 1 if there is a problem.
    """
    from calcidem.app.doctor.checkup import findings

    console = Console(highlight=False)
    levels: Counter[str] = Counter()
    found = []
    for finding in findings(folder):
        found.append(asdict(finding))
        if layout is Format.TABLE:
            console.print(_finding_line(finding), soft_wrap=True)
        levels[finding.level] += 1
    if layout is Format.TABLE:
        all_well = levels.keys() == {"ok"}
        console.print("All is well." if all_well else ", ".join(f"{levels[level]} {level}" for level in _STYLES))
    else:
        tell_rows(found, layout)
    if levels["problem"]:
        raise typer.Exit(1)


def _finding_line(finding: "Finding") -> Text:
    """One line about a finding, and one with its remedy."""
    line = Text(f"{finding.level:<8}", _STYLES[finding.level]).append(f" {finding.subject}: {finding.fact}", "")
    return line.append(f"\n{'':>8} -> {finding.cure}", "bold") if finding.cure else line
