"""Files of the user: a configuration in TOML, and a table of measured velocities, each with all its problems."""

import math
import os
import re
import tomllib
import unicodedata
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calcidem.app.config.checks import cross_check
from calcidem.app.config.schema import (
    SECTIONS,
    SETTLED_BY_FILE,
    TAKEN_FROM_ELSEWHERE,
    Configuration,
    ConfigurationError,
    Problem,
)
from calcidem.dem.engine.fields import FieldError, Settings, field_hints, quote, similar
from calcidem.dem.sample.compaction import checked_disks
from calcidem.input_file import (
    InputFileError,
    Table,
    as_text,
    meaning_of,
    parse_number,
    read_input,
    unit_in_name,
    value_of,
)
from calcidem.wording import pluralize

if TYPE_CHECKING:
    from calcidem.analysis.measured import Target


def load_configuration(path: str | os.PathLike[str], overrides: Mapping[str, Any] | None = None) -> Configuration:
    """Read and check a configuration in a TOML file; `ConfigurationError` with all its problems.

    `InputFileError` if it is no text file of less than 4 MB.

    ``overrides`` are values of section ``[run]`` that replace those of the file; None keeps the value of the file.
    """
    given = {f"run.{key}": value for key, value in (overrides or {}).items() if value is not None}
    return change_configuration(path, given)


def change_configuration(origin: Configuration | str | os.PathLike[str], values: Mapping[str, object]) -> Configuration:
    """Read a TOML file with other values, or change them in a configuration, with all checks.

    ``values`` are by section and key, such as ``{"wave.amplitude": 1e-4}``. `ConfigurationError` with all problems.
    """
    if isinstance(origin, Configuration):
        return read_configuration(put_values({}, values), base=origin)
    document, text = parse_file(Path(origin))
    put_values(document, values)
    try:
        return read_configuration(document, os.fspath(origin), Path(origin).parent)
    except ConfigurationError as error:
        lines, problems = _lines_of_keys(text), []
        for problem in error.problems:
            places = [lines[name] for name in problem.fields if name in lines and name not in values]
            problems.append(replace(problem, message=f"line {places[0]}: {problem.message}") if places else problem)
        raise ConfigurationError(error.source, problems) from None


def put_values(document: dict[str, Any], values: Mapping[str, object]) -> dict[str, Any]:
    """Sections with each value set by its name; what should be a table and is none is left for the reader to refuse."""
    for name, value in values.items():
        *sections, key = name.split(".")
        table = document
        for section in sections:
            table = table.setdefault(section, {}) if isinstance(table, dict) else {}
        if isinstance(table, dict):
            table[key] = value
    return document


def _lines_of_keys(text: str) -> dict[str, int]:
    """Number of the line of each section and ``section.key`` of a text; no protection against odd strings."""
    found: dict[str, int] = {}
    section = ""
    for number, line in enumerate(text.split("\n"), 1):
        if written := re.match(r"""\s*(\[*)\s*([\w."'-]+)\s*[]=]""", line):
            name = re.sub("[\"']", "", written[2])
            section = name if written[1] else section
            found.setdefault(name if written[1] or not section else f"{section}.{name}", number)
    return found


def parse_file(path: Path) -> tuple[dict[str, Any], str]:
    """Sections of a TOML file, and its text; `ConfigurationError` or `InputFileError` with the reason."""
    if not path.exists():
        problem = "the file does not exist; check the name, or write an example with 'calcidem init'"
        raise ConfigurationError(str(path), [Problem(problem)])
    text = as_text(read_input(path, 4_000_000), path)  # bytes; 100,000 listed seeds have fewer
    try:
        document = tomllib.loads(text)
        if not document:
            problem = "the file is empty; write an example with 'calcidem init' and change it"
        elif _is_deeper(document, 8):  # four levels are needed
            problem = "has tables or lists in one another, 8 deep; no key has such a value, leave them out"
        else:
            return document, text
    except (ValueError, RecursionError) as error:  # invalid TOML, too long numbers, too deep brackets
        problem = f'not TOML: {error}; numbers are written 1.5, strings "...", lists [1, 2]'
    raise ConfigurationError(str(path), [Problem(problem)])


def _is_deeper(value: object, levels: int) -> bool:
    """Whether tables and lists are nested more deeply than this."""
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    return any(levels == 0 or _is_deeper(item, levels - 1) for item in inner)


def read_configuration(
    document: Mapping[str, Any],
    source: str = "configuration",
    folder: Path = Path(),
    base: Configuration | None = None,
) -> Configuration:
    """Convert a mapping of sections to a checked configuration; file names in it are relative to the folder.

    Keys that are left out have the values of ``base``, by default the default ones. `ConfigurationError` with all
    problems.
    """
    configuration = base or Configuration()
    problems = [
        Problem(f"{name}: unknown section; {similar(name, SECTIONS)}", (name,))
        for name in document
        if name not in SECTIONS
    ]
    for section, kinds in SECTIONS.items():
        values = document.get(section, {})
        if not isinstance(values, Mapping):
            cure = f"write [{section}] and its keys below it"
            problems.append(Problem(f"{section} = {quote(values)}: is not a section; {cure}", (section,)))
            continue
        known = [name for kind in kinds.values() for name in field_hints(kind)]
        known = [name for name in known if f"{section}.{name}" not in TAKEN_FROM_ELSEWHERE]
        given = {}
        for key, value in values.items():
            place = f"{section}.{key}"
            if key not in known:
                other = TAKEN_FROM_ELSEWHERE.get(place)
                cure = f"{other} says it" if other else similar(key, known)
                problems.append(Problem(f"{place}: unknown key of [{section}]; {cure}", (place,)))
            elif words := _impossible(value):
                problems.append(Problem(f"{place} = {quote(value)}: {words}", (place,)))
            else:
                given[key] = value
        for part, kind in kinds.items():
            own = {key: value for key, value in given.items() if key in field_hints(kind)}
            made, refused = _changed(getattr(configuration, part), own)
            configuration = replace(configuration, **{part: made})
            problems += [problem.within(section) for problem in refused]
    if configuration.packing_draw.file is not None and "file" in document.get("packing", {}):
        configuration, refused = _take_own_disks(configuration, document["packing"], folder)
        problems += refused
    pattern = replace(configuration.pattern, sand_density=configuration.sand.density)
    configuration = replace(configuration, pattern=pattern)
    # A wrong field has the value of the base, which should not be compared with other fields.
    broken = {field for problem in problems for field in problem.fields}
    problems += [problem for problem in cross_check(configuration) if not broken & set(problem.fields)]
    if problems:
        raise ConfigurationError(source, problems)
    return configuration


def _changed(part: Settings, values: dict[str, Any]) -> tuple[Settings, list[Problem]]:
    """A part of a configuration with other values, and problems of those that it refuses; these are not changed.

    Refused values are left out until none is left, since combinations of values are checked when each is valid.
    """
    problems: list[Problem] = []
    while True:
        try:
            return replace(part, **values), problems
        except FieldError as error:
            problems += error.problems
            named = {name.split(".")[0] for problem in error.problems for name in problem.fields}
            values = {name: value for name, value in values.items() if name not in named}


def _impossible(value: object) -> str:
    """Problem and remedy of a value that no field can have in a file; empty for all others."""
    if isinstance(value, list | tuple | dict):
        return next(filter(None, map(_impossible, value.values() if isinstance(value, dict) else value)), "")
    if isinstance(value, int) and value.bit_length() > 63:  # of TOML and of databases
        return f"has more than 64 bits; give at most {2**63 - 1}"
    # Products and reciprocals of several such numbers are still finite.
    if isinstance(value, float) and value != 0.0 and not 1e-30 <= abs(value) <= 1e30:
        problem = "is out of range" if math.isfinite(value) else "is not finite"
        return f"{problem}; give 0, or a number of 1e-30 to 1e+30 in SI units"
    if isinstance(value, str) and any(unicodedata.category(character) in {"Cc", "Cs"} for character in value):
        return "has control characters; write it without"
    return ""


def _take_own_disks(
    configuration: Configuration, given: Mapping[str, Any], folder: Path
) -> tuple[Configuration, list[Problem]]:
    """Read the file of ``[packing]``, and put the values that it determines into the configuration.

    ``given`` is the section as given; the name of the file is relative to ``folder``. Return the configuration with the
    size of box and disks, if the file is valid, and problems of the file or contradictions to it.
    """
    problems = [
        Problem(
            f"packing.{key} = {quote(given[key])}: the disks in packing.file settle it; leave one of the two out",
            (f"packing.{key}", "packing.file"),
        )
        for key in SETTLED_BY_FILE
        if key in given
    ]
    rule, draw = configuration.packing, configuration.packing_draw
    try:
        path = (folder / Path(str(draw.file)).expanduser()).absolute()
        _, y, radius, digest = checked_disks(path, rule.width)
        smallest, largest = (2.0 * float(value) for value in (radius.min(), radius.max()))
        rule = replace(rule, height=float(np.max(y + radius)), diameter=(smallest, largest))
        draw = replace(draw, file=str(path), file_sha256=digest)
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError if ~ has no folder
        concerned = ("packing.file", *(f"packing.{key}" for key in SETTLED_BY_FILE))  # other checks would be in vain
        problems.append(Problem(f"packing.file = {quote(draw.file)}: {error}", concerned))
    return replace(configuration, packing=rule, packing_draw=draw), problems


KNOWN_COLUMNS = {
    "content": "((caco3|calcite|carbonate|cement)(content)?|content)(bymass|bydrymass)?|(calcit|kalk|karbonat)gehalt",
    "vs": "(mean|average)?(vs|shearwavevelocity|velocity)(mean|average)?|(scher|s)?wellengeschwindigkeit",
    "sd": "(vs)?(sd|std|stdev|stddev|standarddeviation|standardabweichung)(vs)?",
    "samples": "n|samples|specimens|count|numberof(samples|specimens)|(proben)?anzahl",
    "stress": "((effective)?(confining|isotropic|vertical)?(stress|pressure)|confining|confinement|p0?|sigma3?)"
    "|(zell|seiten)?druck|spannung",
    "g0": "g0|gmax|shearmodulus|smallstrainshearmodulus|schubmodul",
    "density": "(bulk|dry|total|wet)?density|rho|dichte",
    "specimen": "specimen|sample|test|id|name|no|nr|label|specimen(id|name|no)|sample(id|name|no)|probe",
}
"""English and German names of the columns by their meaning, see `calcidem.input_file.meaning_of`."""

_UNITS = {  # dimension, unit without one in the file, and what is accepted
    "content": ("percent", "%", "percent, from 0 to 100"),
    "vs": ("velocity", "m/s", "a positive number of m/s"),
    "sd": ("velocity", "m/s", "a positive number of m/s"),
    "stress": ("stress", "kPa", "a positive number of kPa"),
    "g0": ("stress", "MPa", "a positive number of MPa"),
    "density": ("density", "kg/m3", "a positive number of kg/m3"),
}


def read_targets(file: Path, tell: Callable[[str], None] = lambda _: None) -> "tuple[Target, ...]":
    """Read velocities from a table with a row for each specimen, or for the mean of several; ``tell`` what was read.

    A row without number and standard deviation of samples is a specimen, and so is each row of a table that names
    specimens. G0 and density give the velocity if the table has none. `ConfigurationError` with all problems: missing
    columns, invalid numbers and units, fractions or km/s without a unit; `InputFileError` if it cannot be read as text.
    """
    from calcidem.analysis.measured import Target  # noqa: PLC0415 - statistics, which runs do not need

    table = Table.read(read_input(file, 1_000_000), file, KNOWN_COLUMNS, ("content",))  # bytes; no laboratory has more
    columns, meanings = table.places(KNOWN_COLUMNS), [meaning_of(name, KNOWN_COLUMNS) for name in table.names]
    needed = ("content", "vs") if "vs" in columns else ("content", "g0", "density")
    given = f"there are {', '.join(table.names)}" if table.names else "no line names the columns"
    accepted = (
        "'content (%)' or 'Calcitgehalt (%)', and 'Vs (m/s)', 'velocity' or 'Wellengeschwindigkeit', or G0 and density"
    )
    problems = [
        Problem(f"column {'vs' if name == 'g0' else name}: is missing; {given}. Accepted are {accepted}")
        for name in needed
        if name not in columns and (name != "density" or "g0" in columns)
    ]
    twice = [name for name in _UNITS if meanings.count(name) > 1]
    problems += [Problem(f"column {name}: occurs twice; leave one out") for name in twice]
    if not table.rows:
        problems.append(Problem("rows = 0: give a line for each specimen below the names of the columns"))
    units = {}
    for name in filter(columns.__contains__, _UNITS):
        try:
            units[name] = unit_in_name(table.names[columns[name]], _UNITS[name][0])[1]
        except InputFileError as error:
            problems.append(Problem(str(error)))
    if problems:
        raise ConfigurationError(str(file), problems)
    units["sd"] = units.get("sd", "") or units.get("vs", "")
    targets, bare, wrongs = [], set[str](), list[tuple[str, str, str]]()
    for number, row in table.rows:
        if len(row) != len(meanings):
            wrong = f"has {len(row)} entries and not {len(meanings)}; give one for each column, with a point in numbers"
            wrongs.append((f"row {number} = {','.join(row)}", "", wrong))
            continue
        entries = {name: text for name, text in zip(meanings, row, strict=True) if text or name in needed}
        bare |= {name for name in needed if not units[name] and not (parse_number(entries[name]) or ("", "?"))[1]}
        values = {
            name: value_of(entries[name], dimension, units[name] or unit)
            for name, (dimension, unit, _) in _UNITS.items()
            if name in entries
        }
        count = entries.get("samples", "1" if "specimen" in entries or "sd" not in entries else "")
        found = [
            (name, entries[name], f"give {_UNITS[name][2]}")
            for name, value in values.items()
            if not (0.0 <= value <= 100.0 if name == "content" else 0.0 < value < math.inf)
        ]
        if count and not (count.isdecimal() and len(count) < 10 and int(count) > 0):  # digits beyond 4300 are an error
            found.append(("samples", count, "give a whole number of 1 or more"))
        wrongs += [(f"row {number}, {name} = {text!r}", name, cure) for name, text, cure in found]
        if not found:
            vs = values["vs"] if "vs" in columns else math.sqrt(values["g0"] / values["density"])
            samples = int(count) if count else None
            targets.append(Target(values["content"], vs, values.get("sd"), samples, values.get("stress")))
    problems += problems_of_rows(wrongs) if wrongs else _questions(targets, bare)
    if problems:
        raise ConfigurationError(str(file), problems)
    used = ", ".join(f"{name} in '{table.names[columns[name]]}'" for name in KNOWN_COLUMNS if name in columns)
    ignored = ", ".join(name for name, meaning in zip(table.names, meanings, strict=True) if not meaning)
    tell(f"{file}: {len(targets)} measurements; {used}{'; not used: ' * bool(ignored)}{ignored}")
    return tuple(targets)


def problems_of_rows(wrongs: Sequence[tuple[str, str, str]]) -> list[Problem]:
    """One problem for each name and remedy in some (place of an entry, its name, remedy), with the number of rows."""
    places: dict[tuple[str, str], list[str]] = {}
    for place, name, cure in wrongs:
        places.setdefault((name, cure), []).append(place)
    return [
        Problem(f"{' and '.join((first, *[pluralize(len(others), 'more row')] * bool(others)))}: {cure}")
        for (_, cure), (first, *others) in places.items()
    ]


def _questions(targets: "Sequence[Target]", bare: Collection[str]) -> Iterator[Problem]:
    """Values that are more likely in another unit, if their columns are ``bare``: without a unit."""
    most, speeds = max(row.content for row in targets), [row.vs for row in targets]
    if "content" in bare and 0.0 < most <= 0.2:
        cure = "percent or parts? Write the unit into the column's name: 'content (%)' or 'content (-)'"
        yield Problem(f"content = {most:g} at most: {cure}")
    if wrong := [row for row in targets if row.sd is not None and row.sd >= row.vs]:
        cure = "is it in the unit of the velocity? Write both into the names of columns: 'Vs (km/s)', 'sd (m/s)'"
        yield Problem(f"sd = {wrong[0].sd:g} m/s at Vs = {wrong[0].vs:g} m/s: {cure}")
    # slower than mud, or faster than rock
    if min(speeds) < 20.0 or max(speeds) > 5000.0:
        cure = "is it in other units? Write them into the names of columns: 'Vs (km/s)', 'G0 (MPa)', 'density (kg/m3)'"
        cure += "; is there a mark of thousands? Leave it out"
        yield Problem(f"vs = {min(speeds):g} to {max(speeds):g} m/s: {cure}")
