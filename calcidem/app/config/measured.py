"""Table of measured velocities, for calibrations, figures and reports."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path

from calcidem.analysis.measured import Target
from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.input_file import read_input
from calcidem.table import Table, meaning_of, parse_number, unit_in_name, value_of

KNOWN_COLUMNS = {
    "content": "((caco3|calcite|carbonate|cement)(content)?|content)(bymass|bydrymass)?",
    "vs": "(mean|average)?(vs|shearwavevelocity|velocity)(mean|average)?",
    "sd": "(vs)?(sd|std|stdev|stddev|standarddeviation)(vs)?",
    "samples": "n|samples|specimens|count|numberof(samples|specimens)",
    "stress": "((effective)?(confining|isotropic|vertical)?(stress|pressure)|confining|confinement|p0?|sigma3?)",
    "g0": "g0|gmax|shearmodulus|smallstrainshearmodulus",
    "density": "(bulk|dry|total|wet)?density|rho",
    "specimen": "specimen|sample|test|id|name|no|nr|label|specimen(id|name|no)|sample(id|name|no)",
}
"""Names of the columns by their meaning, see `calcidem.table.meaning_of`."""

_UNITS = {  # dimension, unit without one in the file, and what is accepted
    "content": ("percent", "%", "percent, from 0 to 100"),
    "vs": ("velocity", "m/s", "a positive number of m/s"),
    "sd": ("velocity", "m/s", "a positive number of m/s"),
    "stress": ("stress", "kPa", "a positive number of kPa"),
    "g0": ("stress", "MPa", "a positive number of MPa"),
    "density": ("density", "kg/m3", "a positive number of kg/m3"),
}


def read_targets(file: Path, tell: Callable[[str], None] = lambda _: None) -> tuple[Target, ...]:
    """Read velocities from a table with a row for each specimen, or for the mean of several; ``tell`` what was read.

    A row without number and standard deviation of samples is a specimen, and so is each row of a table that names
    specimens. G0 and density give the velocity if the table has none. `ConfigurationError` with all problems: missing
    columns, invalid numbers, fractions or km/s without a unit; `InputFileError` if it cannot be read as text.
    """
    table = Table.read(read_input(file, 1_000_000), file, KNOWN_COLUMNS, ("content",))  # bytes; no laboratory has more
    columns, meanings = table.places(KNOWN_COLUMNS), [meaning_of(name, KNOWN_COLUMNS) for name in table.names]
    needed = ("content", "vs") if "vs" in columns else ("content", "g0", "density")
    given = f"there are {', '.join(table.names)}" if table.names else "no line names the columns"
    problems = [
        Problem(f"column {'vs' if name == 'g0' else name}: is missing; {given}. Write 'content (%)' and 'Vs (m/s)'")
        for name in needed
        if name not in columns and (name != "density" or "g0" in columns)
    ]
    twice = [name for name in _UNITS if meanings.count(name) > 1]
    problems += [Problem(f"column {name}: occurs twice; leave one out") for name in twice]
    if not table.rows:
        problems.append(Problem("rows = 0: give a line for each specimen below the names of the columns"))
    if problems:
        raise ConfigurationError(str(file), problems)
    units = {name: unit_in_name(table.names[columns[name]], _UNITS[name][0])[1] for name in _UNITS if name in columns}
    units["sd"] = units.get("sd", "") or units.get("vs", "")
    targets, bare = [], set[str]()
    for number, row in table.rows:
        if len(row) != len(meanings):
            wrong = f"has {len(row)} entries and not {len(meanings)}; give one for each column, with a point in numbers"
            problems.append(Problem(f"row {number} = {','.join(row)}: {wrong}"))
            continue
        entries = {name: text for name, text in zip(meanings, row, strict=True) if text or name in needed}
        bare |= {name for name in needed if not units[name] and not (parse_number(entries[name]) or ("", "?"))[1]}
        values = {
            name: value_of(entries[name], dimension, units[name] or unit)
            for name, (dimension, unit, _) in _UNITS.items()
            if name in entries
        }
        count = entries.get("samples", "1" if "specimen" in entries or "sd" not in entries else "")
        found = list(_problems_of_row(number, entries, values, count))
        problems += found
        if not found:
            vs = values["vs"] if "vs" in columns else math.sqrt(values["g0"] / values["density"])
            samples = int(count) if count else None
            targets.append(Target(values["content"], vs, values.get("sd"), samples, values.get("stress")))
    problems += [] if problems else _questions(targets, bare)
    if problems:
        raise ConfigurationError(str(file), problems)
    used = ", ".join(f"{name} in '{table.names[columns[name]]}'" for name in KNOWN_COLUMNS if name in columns)
    ignored = ", ".join(name for name, meaning in zip(table.names, meanings, strict=True) if not meaning)
    tell(f"{file}: {len(targets)} measurements; {used}{'; not used: ' * bool(ignored)}{ignored}")
    return tuple(targets)


def _problems_of_row(
    number: int, entries: Mapping[str, str], values: Mapping[str, float], count: str
) -> Iterator[Problem]:
    """Entries of a row that are refused."""
    for name, value in values.items():
        if not (0.0 <= value <= 100.0 if name == "content" else 0.0 < value < math.inf):
            yield Problem(f"row {number}, {name} = {entries[name]!r}: give {_UNITS[name][2]}")
    if count and not (count.isdecimal() and int(count) > 0):
        yield Problem(f"row {number}, samples = {count!r}: give a whole number of 1 or more")


def _questions(targets: Sequence[Target], bare: Collection[str]) -> Iterator[Problem]:
    """Values that are more likely in another unit, if their columns are ``bare``: without a unit."""
    most, speeds = max(row.content for row in targets), [row.vs for row in targets]
    if "content" in bare and 0.0 < most <= 0.2:
        cure = "percent or parts? Write the unit into the column's name: 'content (%)' or 'content (-)'"
        yield Problem(f"content = {most:g} at most: {cure}")
    # slower than mud, or faster than rock
    if set(bare) - {"content"} and (min(speeds) < 20.0 or max(speeds) > 5000.0):
        cure = "is it in other units? Write them into the names of columns: 'Vs (km/s)', 'G0 (MPa)', 'density (kg/m3)'"
        yield Problem(f"vs = {min(speeds):g} to {max(speeds):g} m/s: {cure}")
