"""Readers of disks of other programs: LAMMPS data and dumps, YADE, extended XYZ, and tables such as PFC's lists."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calcidem.dem.kernels.layout import Floats, Integers
from calcidem.dem.sample.packing import PackingFileError
from calcidem.dem.sample.packing_file import FARTHEST
from calcidem.input_file import InputFileError, as_text, read_input
from calcidem.table import Table, factor_of, parse_number, unit_in_name

_BEFORE, _CENTRE = "(?:ball)?(?:pos(?:ition)?|coord(?:inate)?|cent(?:er|re)|centroid|c)?", "cent(?:er|re)"

_KNOWN = {
    **{
        axis: rf"{_BEFORE}{axis}(?:u|pos(?:ition)?|{_CENTRE})?|(?:points?|pos(?:ition)?|coord(?:inate)?s?){number}"
        for number, axis in enumerate("xyz")
    },
    **{f"scaled {axis}": rf"{axis}su?" for axis in "xyz"},
    "radius": "r|rad|radius|ballradius",
    "diameter": "d|dia|diam|diameter",
    "type": "type|mat|matid|material|group|clumpid|species|particletype",
    "id": "id|ballid|particleidentifier",
}
"""Names of columns by their meaning, see `calcidem.table.meaning_of`."""


@dataclass(frozen=True, slots=True, eq=False)
class ForeignDisks:
    """Content of a file, in its unit and frame."""

    form: str
    evidence: str
    """Detected format of the file, and evidence for it."""
    lines: Integers
    """(N,) line of each disk in the file."""
    place: Floats
    """(N, 3) centres; z is 0 without such a column."""
    radius: Floats
    """(N,)."""
    kinds: tuple[str, ...] | None = None
    """(N,) types, groups or materials, as text; None without such a column."""
    box: Floats | None = None
    """(3, 2) lowest and highest x, y and z of the box in the file; None without one."""
    periodic: str = ""
    """Axes in which the box continues on its other side."""
    unit: str = ""
    """Unit of length in the file; empty without one."""
    skipped: tuple[int, ...] = ()
    """Lines below the first disk that are not disks."""

    @staticmethod
    def read(file: Path, columns: Sequence[str] = (), timestep: int | None = None) -> "ForeignDisks":
        """Read the disks of a file, text or text compressed with gzip; its content determines the format.

        ``columns`` are names of the columns from the left, instead of those in the file; names other than x, y, z,
        radius, diameter, type and id are ignored. In a LAMMPS dump the snapshot of ``timestep`` is read, by default the
        last one. `PackingFileError` and `InputFileError` name file, line and remedy.
        """
        content = read_input(file, 500_000_000)  # bytes; a dump of all snapshots of a run may have more
        lines = as_text(content, file, "cp1252").splitlines()
        read = _recognise(lines, file)
        if timestep is not None and read is not _read_dump:
            raise PackingFileError(
                f"timestep = {timestep}: {file} is not a LAMMPS dump and has no snapshots; leave it out"
            )
        try:
            rows = read(file, lines, timestep) if read else _read_table(file, content)
        except InputFileError:
            raise
        except (ValueError, IndexError) as error:
            raise PackingFileError(f"{file} is damaged after its beginning ({error}); was it cut off?") from error
        if columns:
            rows = replace(rows, names=columns, evidence=f"{rows.evidence}; columns as given")
        return _disks_of(file, rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Numbered lines of a file split into entries, and names of the columns; other fields as in `ForeignDisks`."""

    form: str
    evidence: str
    names: Sequence[str]
    entries: list[tuple[int, list[str]]]
    box: Floats | None = None
    unit: str = ""
    periodic: str = ""
    skipped: list[int] = field(default_factory=list)


def _recognise(lines: list[str], file: Path) -> Callable[[Path, list[str], int | None], _Rows] | None:
    """Reader for the format of the first lines; None for a table."""
    head = next((line for line in lines if line.strip()), "")
    if head.startswith("ITEM:"):
        return _read_dump
    if _find_line(lines, r"\s*\d+\s+atoms\b") is not None and _find_line(lines, r"\s*Atoms\b") is not None:
        return _read_data
    if not head:
        raise PackingFileError(f"{file} is empty; give a file with disks")
    if head.strip().isdecimal() and re.search(r"\bProperties=", "".join(lines[1:2])):
        return _read_xyz
    return _read_yade if re.match(r"#\s*format\s", head) else None


def _find_line(lines: list[str], pattern: str) -> int | None:
    """Index of the first line that matches a pattern."""
    return next((index for index, line in enumerate(lines) if re.match(pattern, line)), None)


def _read_data(file: Path, lines: list[str], _timestep: int | None) -> _Rows:
    """Data file of LAMMPS (manual, commands read_data and write_data)."""
    begin = _find_line(lines, r"\s*Atoms\b") or 0
    tilt = _find_line(lines[:begin], r".*\bxy\s+xz\s+yz")
    if tilt is not None and any(float(number) for number in lines[tilt].split()[:3]):
        raise PackingFileError(f"{file}, line {tilt + 1}: the box is tilted; give disks in a rectangular box")
    entries = []
    for number, line in enumerate(lines[begin + 1 :], begin + 2):
        words = line.split("#")[0].split()
        if words and not re.match(r"[-+.\d]", words[0]):
            break  # the next section
        if words:
            entries.append((number, words))
    named = re.match(r"\s*Atoms\s*#\s*(\S+)", lines[begin])
    style, count = named[1] if named else "sphere", len(entries[0][1]) if entries else 0
    columns = {  # of the atom styles with sizes (manual, command read_data)
        "sphere": ("id", "type", "diameter", "density", "x", "y", "z"),
        "bpm/sphere": ("id", "molecule", "type", "diameter", "density", "x", "y", "z"),
    }.get(style, ())
    if not entries or count not in {len(columns), len(columns) + 3}:  # with or without image flags
        raise PackingFileError(
            f"{file}, line {begin + 1}: '{lines[begin].strip()}' with {count} columns has no sizes of disks; write it "
            "with atom_style sphere or bpm/sphere, or write a dump with the columns id type x y z radius"
        )
    _refuse_missing(file, lines[_find_line(lines, r"\s*\d+\s+atoms\b") or 0], entries)
    said = "" if named else "; no atom style is named, and sphere taken"
    bounds = [_find_line(lines[:begin], rf".*\b{axis}lo\s+{axis}hi") for axis in "xyz"]
    box = None
    if None not in bounds:
        box = np.array([[float(word) for word in lines[index or 0].split()[:2]] for index in bounds])
    evidence = f"line {begin + 1} is '{lines[begin].strip()}'{said}"
    unit = _unit_of_style(r"units\s*=\s*(\w+)", lines[0])
    return _Rows("LAMMPS data file", evidence, columns, entries, box, unit)


def _read_dump(file: Path, lines: list[str], timestep: int | None) -> _Rows:
    """One snapshot of a text dump of LAMMPS (manual, command dump)."""
    starts = [index for index, line in enumerate(lines) if line.startswith("ITEM: TIMESTEP")]
    steps = [lines[index + 1].strip() for index in starts if index + 1 < len(lines)]
    if timestep is not None and str(timestep) not in steps:
        shown = ", ".join(steps) if len(steps) <= 12 else f"{steps[0]}, {steps[1]}, ... {steps[-1]}"
        raise PackingFileError(f"{file}: timestep = {timestep} is none of its snapshots; choose of {shown}")
    chosen = len(steps) - 1 if timestep is None else steps.index(str(timestep))
    begin = starts[chosen]
    end = starts[chosen + 1] if chosen + 1 < len(starts) else len(lines)
    items = {line[6:].split(" ")[0]: index for index, line in enumerate(lines[begin:end], begin) if line[:5] == "ITEM:"}
    if not {"NUMBER", "BOX", "ATOMS"} <= items.keys():
        raise PackingFileError(f"{file}: the snapshot in line {begin + 1} has no atoms; was it cut off?")
    bounds = lines[items["BOX"]].split()
    if "xy" in bounds or "abc" in bounds:
        raise PackingFileError(f"{file}, line {items['BOX'] + 1}: the box is tilted; give disks in a rectangular box")
    box = np.array([[float(word) for word in line.split()[:2]] for line in lines[items["BOX"] + 1 : items["BOX"] + 4]])
    entries = [
        (number, line.split()) for number, line in enumerate(lines[items["ATOMS"] + 1 : end], items["ATOMS"] + 2)
    ]
    _refuse_missing(file, lines[items["NUMBER"] + 1], entries)
    evidence = f"line 1 is '{lines[0].strip()}'; timestep {steps[chosen]}, one of {len(steps)}"
    unit = _unit_of_style(r"ITEM: UNITS\n(\w+)", "\n".join(lines[: items["ATOMS"]]))
    periodic = "".join(axis for axis, kind in zip("xyz", bounds[-3:], strict=True) if kind == "pp")
    return _Rows("LAMMPS dump", evidence, lines[items["ATOMS"]].split()[2:], entries, box, unit, periodic)


def _unit_of_style(pattern: str, text: str) -> str:
    """Unit of length of a unit style that suits a packing (LAMMPS manual, command units); empty for another."""
    found = re.search(pattern, text)
    return {"si": "m", "cgs": "cm", "micro": "um", "nano": "nm"}.get(found[1], "") if found else ""


def _refuse_missing(file: Path, line: str, entries: list[tuple[int, list[str]]]) -> None:
    """Refuse another number of atoms than stated."""
    if int(line.split(maxsplit=1)[0]) != len(entries):
        raise PackingFileError(f"{file} says '{line.strip()}', but has {len(entries)} atoms; was it cut off?")


def _read_yade(_file: Path, lines: list[str], _timestep: int | None) -> _Rows:
    """Text export of YADE (manual, yade.export.text and textExt)."""
    first = _find_line(lines, r"#\s*format\s") or 0
    names = lines[first].split("format", 1)[1].strip().split("_")
    entries = [(number, line.split()) for number, line in enumerate(lines, 1) if line.strip() and line[:1] != "#"]
    return _Rows("YADE text export", f"line {first + 1} is '{lines[first].strip()}'", names, entries)


def _read_xyz(file: Path, lines: list[str], _timestep: int | None) -> _Rows:
    """Last frame of an extended XYZ file (manual of OVITO, file formats), with its cell and boundaries."""
    begin, after = 0, 0
    while after < len(lines) and lines[after].strip():
        begin, after = after, after + int(lines[after]) + 2
    words = dict(re.findall(r"""(\w+)=["']?((?<=["'])[^"']*|\S+)""", lines[begin + 1]))
    names = []
    kinds = words["Properties"].split(":")
    for name, count in zip(kinds[::3], kinds[2::3], strict=True):
        names += ["x", "y", "z"] if name == "pos" else [name] if count == "1" else [name] * int(count)
    entries = [(number, line.split()) for number, line in enumerate(lines[begin + 2 : after], begin + 3)]
    _refuse_missing(file, lines[begin], entries)
    box = None
    if "Lattice" in words:
        cell = np.array([float(word) for word in words["Lattice"].split()]).reshape(3, 3)
        if (cell != np.diag(np.diag(cell))).any():
            raise PackingFileError(
                f"{file}, line {begin + 2}: the box is tilted; give disks in a rectangular box (Lattice with zeros)"
            )
        origin = np.array([float(word) for word in words.get("Origin", "0 0 0").split()])
        box = np.stack([origin, origin + np.diag(cell)], axis=1)
    periodic = "".join(axis for axis, kind in zip("xyz", words.get("pbc", "").split(), strict=False) if kind in "T1")
    return _Rows("extended XYZ", f"line {begin + 2} has Properties", names, entries, box, periodic=periodic)


def _read_table(file: Path, content: bytes) -> _Rows:
    """Table with named columns: CSV with any delimiter, or a list printed by PFC."""
    table = Table.read(content, file, _KNOWN, ("x", "y"), 3)
    if not table.rows:
        raise PackingFileError(f"{file} has no line of numbers; give a table with the columns x, y and radius")
    full = [sum(map(bool, map(parse_number, words))) >= 3 for _, words in table.rows]
    wide = len(table.rows[full.index(True)][1]) if any(full) else 0
    is_row = [has_numbers or len(words) == wide for has_numbers, (_, words) in zip(full, table.rows, strict=True)]
    is_pfc = re.search(rb"\bball\b", b"\n".join(content.split(b"\n", table.head)[: table.head]), re.IGNORECASE)
    return _Rows(
        "PFC ball list" if is_pfc else "table",
        f"line {table.head} names the columns" if table.head else "its columns have no names",
        table.names,
        [row for row, good in zip(table.rows, is_row, strict=True) if good],
        unit=next((unit for name in table.names if (unit := unit_in_name(name, "length")[1])), ""),
        skipped=[number for (number, _), good in zip(table.rows, is_row, strict=True) if not good],
    )


def _disks_of(file: Path, rows: _Rows) -> ForeignDisks:
    """Disks of rows, in the order of their numbers if given."""
    columns = Table(tuple(rows.names), 0, []).places(_KNOWN)
    if rows.box is not None:
        scaled = {axis: columns[f"scaled {axis}"] for axis in "xyz" if f"scaled {axis}" in columns}
        columns = scaled | columns
    size = "radius" if "radius" in columns else "diameter"
    if missing := [name for name in ("x", "y", size) if name not in columns]:
        raise PackingFileError(
            f"{file} ({rows.form}) has no column {', '.join(missing).replace('diameter', 'radius or diameter')}; "
            f"it has {', '.join(rows.names) or 'no names'}. Name them from the left with columns, such as x,y,radius"
        )
    numbers = _numbers_of(file, rows, [(name, columns[name]) for name in ("x", "y", "z", size) if name in columns])
    for name in numbers:
        own = unit_in_name(rows.names[columns[name]], "length")[1]
        if own and factor_of(own, "length") != factor_of(rows.unit, "length"):
            numbers[name] *= factor_of(own, "length") / factor_of(rows.unit, "length")
    centres = np.column_stack([numbers.get(axis, np.zeros(len(rows.entries))) for axis in "xyz"])
    for index, axis in enumerate("xyz"):
        if rows.box is not None and columns.get(axis) == columns.get(f"scaled {axis}", -1):
            centres[:, index] = rows.box[index, 0] + centres[:, index] * np.ptp(rows.box[index])
    identity, kinds = (
        ["".join(words[columns[name] : columns[name] + 1]) for _, words in rows.entries] if name in columns else []
        for name in ("id", "type")
    )
    order = np.arange(len(rows.entries))
    if all(word.isdecimal() for word in identity) and len(set(identity)) == len(order):
        order = np.argsort([int(word) for word in identity], kind="stable")
    return ForeignDisks(
        form=rows.form,
        evidence=rows.evidence,
        lines=np.array([number for number, _ in rows.entries])[order],
        place=centres[order],
        radius=numbers[size][order] * (1.0 if size == "radius" else 0.5),
        kinds=tuple(kinds[row] for row in order) if kinds else None,
        box=rows.box,
        periodic=rows.periodic,
        unit=rows.unit,
        skipped=tuple(rows.skipped),
    )


def _numbers_of(file: Path, rows: _Rows, columns: list[tuple[str, int]]) -> dict[str, Floats]:
    """Finite numbers (N,) of some columns."""
    found = np.empty((len(rows.entries), len(columns)))
    for row, (number, words) in enumerate(rows.entries):
        try:
            found[row] = [float(words[place]) for _, place in columns]
            wrong = not (np.abs(found[row]) <= FARTHEST).all()
        except (ValueError, IndexError):
            wrong = True
        if wrong:
            wanted = ", ".join(f"{name} in column {place + 1}" for name, place in columns)
            raise PackingFileError(
                f"{file}, line {number}: '{' '.join(words)[:60]}' is not a disk; {wanted} have to be finite numbers"
            )
    return dict(zip((name for name, _ in columns), found.T, strict=True))
