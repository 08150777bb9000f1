"""``calcidem doctor``: what stands between this machine and a campaign, one finding per line."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from calcidem.app.doctor import Finding, FindingLevel
from calcidem.app.doctor.checkup import findings

_STYLES = {FindingLevel.OK: "green", FindingLevel.WARNING: "yellow", FindingLevel.PROBLEM: "bold red"}


def doctor_command(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder for the database; the current one by default.")
    ] = Path(),
) -> None:
    """Check what a campaign needs here: MPI, cores, disk, caches and Slurm; say what to do about what is wrong.

    Ends with 1 if there is a problem. Takes a few seconds, since it starts two ranks and writes a small database.
    """
    console = Console(highlight=False)
    found = []
    for finding in findings(folder):
        console.print(_finding_line(finding), soft_wrap=True)
        found.append(finding)
    console.print(_findings_summary(found))
    if any(finding.level is FindingLevel.PROBLEM for finding in found):
        raise typer.Exit(1)


def _finding_line(finding: Finding) -> Text:
    """One line about a finding, the cure on one of its own."""
    line = Text(f"{finding.level:<8}", _STYLES[finding.level]).append(f" {finding.subject}: {finding.fact}", "")
    return line.append(f"\n{'':>8} -> {finding.cure}", "bold") if finding.cure else line


def _findings_summary(found: list[Finding]) -> str:
    """The last line."""
    numbers = {level: sum(finding.level is level for finding in found) for level in FindingLevel}
    if not numbers[FindingLevel.PROBLEM] and not numbers[FindingLevel.WARNING]:
        return "All is well."
    return ", ".join(f"{number} {level}" for level, number in numbers.items())
