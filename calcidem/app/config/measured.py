"""File of measured means and scatter of Vs, for calibrations, figures and reports."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from calcidem.analysis.measured import Target
from calcidem.app.config.errors import ConfigurationError, Problem

_COLUMNS = {
    "content": "percent, 0 or more",
    "vs": "a positive number of m/s",
    "sd": "a positive number of m/s",
    "samples": "a whole number of 2 or more",
}
"""Columns of a file of targets and their values; the last two, or entries of them, may be missing."""

_MOST_CHARACTERS = 1_000_000
"""Largest number of characters of a file, far more than a table of all contents has."""

_REQUIRED = ("content", "vs")


def read_targets(file: Path) -> tuple[Target, ...]:
    """Read means and, if given, standard deviations and numbers of samples from a CSV file.

    Lines that begin with ``#`` are comments. `ConfigurationError` with all problems: missing or unknown columns,
    invalid numbers, repeated contents.
    """
    with file.open(encoding="utf-8-sig", errors="replace", newline="") as source:
        text = source.read(_MOST_CHARACTERS)  # so that a device cannot fill the memory
    try:
        reader = csv.reader(io.StringIO(text))
        table = [(reader.line_num, [entry.strip() for entry in line]) for line in reader]
    except csv.Error as error:
        problem = f"no table of targets ({error}); give a line for each content, numbers with commas between them"
        raise ConfigurationError(str(file), [Problem(problem)]) from error
    lines = [(number, line) for number, line in table if any(line) and not line[0].startswith("#")]
    header, rows = (lines[0][1], lines[1:]) if lines else ([], [])
    problems = list(_header_problems(header, rows))
    targets: list[Target] = []
    for number, row in rows if not problems else ():
        wrong = list(_row_problems(number, header, row))
        problems += wrong
        if not wrong:
            values = {name: float(text) for name, text in zip(header, row, strict=True) if text}
            samples = int(values["samples"]) if "samples" in values else None
            targets.append(Target(values["content"], values["vs"], values.get("sd"), samples))
    contents = [target.content for target in targets]
    twice = sorted({content for content in contents if contents.count(content) > 1})
    problems += [Problem(f"content = {content:g}: occurs twice; leave one out") for content in twice]
    if problems:
        raise ConfigurationError(str(file), problems)
    return tuple(targets)


def _header_problems(header: Sequence[str], rows: Sequence[object]) -> Iterator[Problem]:
    """Problems of the columns."""
    for name in (name for name in _REQUIRED if name not in header):
        yield Problem(f"column {name}: is missing; give a header line such as 'content,vs' or 'content,vs,sd,samples'")
    for name in (name for name in header if name not in _COLUMNS or header.count(name) > 1):
        yield Problem(f'column "{name}": is unknown or occurs twice; there are {", ".join(_COLUMNS)}')
    if not rows:
        yield Problem("rows = 0: give a line for each content below the header")


def _row_problems(number: int, header: Sequence[str], row: Sequence[str]) -> Iterator[Problem]:
    """Problems of a row."""
    if len(row) != len(header):
        cure = "give one for each column, with a point in numbers"
        yield Problem(f"row {number} = {','.join(row)}: has {len(row)} entries and not {len(header)}; {cure}")
        return
    for name, text in zip(header, row, strict=True):
        try:
            value = float(text) if text or name in _REQUIRED else 2.0
        except ValueError:
            value = math.nan
        good = {"content": value >= 0.0, "samples": value >= 2.0 and value % 1.0 == 0.0}.get(
            name, value > 0.0
        )  # a scatter needs two
        if not good or math.isinf(value):
            yield Problem(f"row {number}, {name} = {text!r}: give {_COLUMNS[name]}")
