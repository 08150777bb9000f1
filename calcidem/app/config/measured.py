"""File of measured means and scatter of Vs, for calibrations, figures and reports."""

import csv
import io
import math
from pathlib import Path

from calcidem.analysis.measured import Target
from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.input_file import read_text

COLUMNS = {
    "content": "percent, 0 or more",
    "vs": "a positive number of m/s",
    "sd": "a positive number of m/s",
    "samples": "a whole number of 2 or more",  # a scatter needs two
}
"""Columns of a file of targets and their values; the last two, or entries of them, may be missing."""


def read_targets(file: Path) -> tuple[Target, ...]:
    """Read means and, if given, standard deviations and numbers of samples from a CSV file.

    Lines that begin with ``#`` are comments. `ConfigurationError` with all problems: missing or unknown columns,
    invalid numbers, repeated contents; `InputFileError` if it cannot be read as text.
    """
    text = read_text(file, 1_000_000)  # bytes; far more than a table of all contents has
    try:
        reader = csv.reader(io.StringIO(text))
        table = [(reader.line_num, [entry.strip() for entry in line]) for line in reader]
    except csv.Error as error:
        problem = f"no table of targets ({error}); give a line for each content, numbers with commas between them"
        raise ConfigurationError(str(file), [Problem(problem)]) from error
    lines = [(number, line) for number, line in table if any(line) and not line[0].startswith("#")]
    header, rows = (lines[0][1], lines[1:]) if lines else ([], [])
    cure = "give a header line such as 'content,vs' or 'content,vs,sd,samples'"
    problems = [Problem(f"column {name}: is missing; {cure}") for name in ("content", "vs") if name not in header]
    problems += [
        Problem(f'column "{name}": is unknown or occurs twice; there are {", ".join(COLUMNS)}')
        for name in header
        if name not in COLUMNS or header.count(name) > 1
    ]
    if not rows:
        problems.append(Problem("rows = 0: give a line for each content below the header"))
    targets: list[Target] = []
    for number, row in rows if not problems else ():
        if len(row) != len(header):
            wrong = f"has {len(row)} entries and not {len(header)}; give one for each column, with a point in numbers"
            problems.append(Problem(f"row {number} = {','.join(row)}: {wrong}"))
            continue
        values = {name: _number(name, text) for name, text in zip(header, row, strict=True) if text}
        for name, text in zip(header, row, strict=True):
            if math.isnan(values.get(name, math.nan if name in {"content", "vs"} else 0.0)):
                problems.append(Problem(f"row {number}, {name} = {text!r}: give {COLUMNS[name]}"))
        samples = values.get("samples")
        sizes = values.get("content", 0.0), values.get("vs", 0.0), values.get("sd")
        targets.append(Target(*sizes, None if samples is None or math.isnan(samples) else int(samples)))
    contents = [target.content for target in targets]
    twice = sorted({content for content in contents if contents.count(content) > 1})
    problems += [Problem(f"content = {content:g}: occurs twice; leave one out") for content in twice]
    if problems:
        raise ConfigurationError(str(file), problems)
    return tuple(targets)


def _number(column: str, text: str) -> float:
    """Value of an entry; NaN if the column does not take it."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    good = {"content": value >= 0.0, "samples": value >= 2.0 and value % 1.0 == 0.0}.get(column, value > 0.0)
    return value if good and math.isfinite(value) else math.nan
