"""``calcidem explain``: parts of the computation that a campaign needs or omits."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from calcidem.app.cli.arguments import DEFAULT_CONFIGURATION, ConfigurationFile, JudgedDatabase, OnlyContents
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.app.cli.terminal import printable, tell

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.studies.accuracy.questions import MeasuredErrors
    from calcidem.app.studies.explain import Explanation

_DEFAULT_CELLS = 8
"""Number of measured seeds of one content, one batch."""


def explain_command(
    configuration: ConfigurationFile = DEFAULT_CONFIGURATION,
    content: OnlyContents = None,
    accuracy: Annotated[
        Path | None, typer.Option(metavar="FILE.json", help="Result of 'calcidem accuracy --out'.")
    ] = None,
    db: JudgedDatabase = None,
    layout: FormatOption = Format.TABLE,
) -> None:
    """Show which parts of the computation each content needs, why the others can be omitted, and what this saves.

    Times and differences are measured now, errors by 'calcidem accuracy'. By default three contents are shown.
    """
    from calcidem.app.cli.tables import make_console
    from calcidem.app.config.reader import change_configuration, load_configuration
    from calcidem.app.config.reference import calibration_note
    from calcidem.app.studies.accuracy.questions import MeasuredErrors
    from calcidem.app.studies.cells import Cells
    from calcidem.app.studies.explain import explain

    loaded = load_configuration(configuration)
    contents = sorted(loaded.campaign.contents)
    chosen = sorted(set(content or (contents[0], contents[len(contents) // 2], contents[-1])))
    loaded = change_configuration(loaded, {"campaign.contents": chosen})
    cells, _ = Cells.of_campaign(loaded, min(_DEFAULT_CELLS, loaded.run.lanes), db, tell)
    try:
        measured = MeasuredErrors.find(loaded.hash, cells.experiment.packing.content_hash, accuracy)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    if note := calibration_note(loaded):
        tell(note)
    rows = explain(cells, measured)
    if layout is not Format.TABLE:
        tell_rows([_explanation_row(row) for row in rows], layout)
        return
    console = make_console()
    for value in chosen:
        console.print(_explanation_table(value, [row for row in rows if row.content == value]))
    console.print(printable(_errors_source(measured, str(configuration))), markup=False)


def _errors_source(measured: "MeasuredErrors | None", configuration: str) -> str:
    """Source of the errors, or how to get them."""
    if measured is None:
        return (
            "The errors of this campaign have not been measured yet. To see them here, run "
            f"'calcidem accuracy {configuration} --out DIR' and add --accuracy DIR/accuracy.json."
        )
    return f"Errors: largest of the cells that calcidem accuracy measured, from {measured.source}."


def _explanation_table(content: float, rows: "Iterable[Explanation]") -> Table:
    """Table of one content."""
    from calcidem.app.cli.tables import make_table

    numbers = ("time of the alternative", "change of Vs", "error of Vs, own and of the alternative")
    table = make_table(f"{content:g} % of calcite", "part", "needed", "why", numbers=numbers)
    for row in rows:
        table.add_row(
            row.alternative.what,
            "yes" if row.alternative.needed else "left out",
            row.alternative.why,
            "-" if row.time_ratio is None else f"{row.time_ratio:.2f} x",
            "-" if row.difference is None else f"{100.0 * row.difference:.2g} %",
            f"{_percent(row.error)}, {_percent(row.other_error)}" if row.alternative.setting else "-",
        )
    return table


def _explanation_row(row: "Explanation") -> dict[str, Any]:
    """Data of one part."""
    part = row.alternative
    return {
        "content": row.content,
        "part": part.what,
        "needed": part.needed,
        "why": part.why,
        "time_ratio": row.time_ratio,
        "difference": row.difference,
        "error": row.error,
        "other_error": row.other_error,
    }


def _percent(error: float | None) -> str:
    """Error in percent, or text for an unknown one."""
    return "?" if error is None else f"{100.0 * error:.2g} %"
