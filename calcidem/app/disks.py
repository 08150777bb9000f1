"""Disks of another program (LAMMPS, YADE, OVITO, PFC, any table): reading, and writing for ``[packing] file``."""

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path

import numpy as np

from calcidem.dem.engine.fields import quote
from calcidem.dem.kernels.layout import Flags, Floats, Integers
from calcidem.dem.sample.compaction import FARTHEST, FEWEST_DISKS, refuse_deep_overlaps, write_disks_csv
from calcidem.dem.sample.packing import (
    DEEP_OVERLAP,
    LARGEST_OVERLAP,
    PackingFileError,
    deepest_overlap,
    judge_porosity,
    overlapping_pairs,
)
from calcidem.input_file import UNITS, InputFileError, Table, as_text, factor_of, parse_number, read_input, unit_in_name
from calcidem.storage.files import write_atomically

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
"""Names of columns by their meaning, see `calcidem.input_file.meaning_of`."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Numbered lines of a file split into entries, and what else the file says."""

    form: str
    evidence: str
    """Detected format of the file, and evidence for it."""
    names: Sequence[str]
    """Names of the columns."""
    entries: list[tuple[int, list[str]]]
    """Line and entries of each row."""
    box: Floats | None = None
    """(3, 2) lowest and highest x, y and z of the box in the file; None without one."""
    unit: str = ""
    """Unit of length that the file states; empty without one."""
    periodic: str = ""
    """Axes in which the box continues on its other side."""
    skipped: list[int] = field(default_factory=list)
    """Lines below the first disk that are not disks."""


@dataclass(frozen=True, slots=True, eq=False)
class ForeignDisks:
    """Disks of a file, in its unit and frame."""

    rows: _Rows
    """Rows from which they were read."""
    lines: Integers
    """(N,) line of each disk in the file."""
    place: Floats
    """(N, 3) centres; z is 0 without such a column."""
    radius: Floats
    """(N,)."""
    kinds: tuple[str, ...] | None
    """(N,) types, groups or materials, as text; None without such a column."""
    unit: str
    """Unit of length in the file or in the names of its columns; empty without one."""

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
    comments = list(takewhile(lambda line: line[:1] == "#" or not line.strip(), lines))
    return None if _find_line(comments, r"#\s*format\s") is None else _read_yade


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
    style, count = named[1] if named else "", len(entries[0][1]) if entries else 0
    columns = {  # of the atom styles with sizes (manual, command read_data)
        "sphere": ("id", "type", "diameter", "density", "x", "y", "z"),
        "bpm/sphere": ("id", "molecule", "type", "diameter", "density", "x", "y", "z"),
    }.get(style, ())
    if not entries or count not in {len(columns), len(columns) + 3}:  # with or without image flags
        raise PackingFileError(
            f"{file}, line {begin + 1}: '{lines[begin].strip()}' with {count} columns has no sizes of disks; name its "
            "style, as in 'Atoms # sphere', write it with atom_style sphere or bpm/sphere, or write a dump with the "
            "columns id type x y z radius"
        )
    _refuse_missing(file, lines[_find_line(lines, r"\s*\d+\s+atoms\b") or 0], entries)
    bounds = [_find_line(lines[:begin], rf".*\b{axis}lo\s+{axis}hi") for axis in "xyz"]
    box = None
    if None not in bounds:
        box = np.array([[float(word) for word in lines[index or 0].split()[:2]] for index in bounds])
    evidence = f"line {begin + 1} is '{lines[begin].strip()}'"
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
        (number, line.split())
        for number, line in enumerate(lines[items["ATOMS"] + 1 : end], items["ATOMS"] + 2)
        if line.strip()
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
        unit=next(
            (unit for unit in (unit_in_name(name)[1] for name in table.names) if factor_of(unit, "length") > 0.0), ""
        ),
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
    units = {name: unit_in_name(rows.names[columns[name]], "length")[1] for name in numbers}
    of_file = rows.unit or next(filter(None, units.values()), "")
    for name, own in units.items():
        if own and factor_of(own, "length") != factor_of(of_file, "length"):
            numbers[name] *= factor_of(own, "length") / factor_of(of_file, "length")
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
        rows,
        lines=np.array([number for number, _ in rows.entries])[order],
        place=centres[order],
        radius=numbers[size][order] * (1.0 if size == "radius" else 0.5),
        kinds=tuple(kinds[row] for row in order) if kinds else None,
        unit=of_file,
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


@dataclass(frozen=True, slots=True, eq=False)
class ImportedPacking:
    """Imported disks of a file; its text is the report."""

    source: Path
    out: Path
    """File that was read, and file that was written."""
    form: str
    evidence: str
    """Detected format of the source, and evidence for it."""
    x: Floats
    y: Floats
    radius: Floats
    """(N,) m; left wall and floor are at 0."""
    width: float
    height: float
    """Size of the box: between the walls, and up to the highest disk, m."""
    origin: tuple[float, float]
    """Left wall and floor in the frame of the source, m."""
    left_out: tuple[str, ...]
    """Sentences about disks and lines that were left out."""
    remarks: tuple[str, ...]
    """Sentences about the unit, the walls and suspicious values."""
    pairs: int
    """Number of touching pairs."""
    mean_overlap: float
    largest_overlap: float
    """Mean and largest overlap of these, m; 0 without any."""

    @property
    def porosity(self) -> float:
        """1 - area of the disks / area of the box."""
        return 1.0 - float(np.pi * np.sum(self.radius**2)) / (self.width * self.height)

    def __str__(self) -> str:
        """Report in lines."""
        smallest, largest, mean = (2e3 * float(f(self.radius)) for f in (np.min, np.max, np.mean))
        left, floor = self.origin
        moved = f"left wall and floor were at ({left:.6g}, {floor:.6g}) m" if left or floor else "origin kept"
        overlaps = f"mean {self.mean_overlap:.3g} m, largest {self.largest_overlap:.3g} m"
        lines = (
            f"Read {self.source}: {self.form} ({self.evidence})",
            *(f"  left out: {sentence}" for sentence in self.left_out),
            f"  {len(self.radius)} disks, diameters {smallest:.4g} to {largest:.4g} mm, mean {mean:.4g} mm",
            f"  box {self.width:.6g} m x {self.height:.6g} m, porosity {self.porosity:.4f}; {moved}",
            f"  {self.pairs} touching pairs, overlaps: {overlaps}",
            *(f"  {sentence}" for sentence in self.remarks),
        )
        return "\n".join(lines)


def import_packing(  # noqa: PLR0913 - what a file does not say, each by keyword
    source: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    unit: str | None = None,
    columns: Sequence[str] = (),
    types: Sequence[str] = (),
    plane: str | None = None,
    walls: Sequence[float] | None = None,
    timestep: int | None = None,
) -> ImportedPacking:
    """Read the disks of another program, and write them to a CSV file for ``[packing] file``.

    `PackingFileError` if the source cannot be read as disks, or they overlap deeply or lie in several planes.

    Parameters
    ----------
    source
        LAMMPS data file or text dump, text export of YADE, extended XYZ of OVITO, list of PFC, or a table with named
        columns, such as ParaView's; its content determines the format.
    out
        CSV file with x, y and radius in m, floor and left wall at 0.
    unit
        Unit of length: m, cm, mm, um or nm. By default that of the file, or m without one; then sizes that no sand has
        are refused.
    columns
        Names of the columns from the left, instead of those in the file: x, y, z, radius or diameter, type, id; other
        names are ignored.
    types
        Only disks of these types, groups or materials.
    plane
        Axes of the source that become x and y; by default the plane in which most disks lie.
    walls
        Left wall, right wall, floor and lid, in the source's unit and frame; disks beyond them are left out. By default
        the outermost disks touch the walls. A box in the file or round numbers nearby are preferred. A packing that
        continues across periodic sides is refused without walls.
    timestep
        Snapshot of a LAMMPS dump; by default the last one.

    Examples
    --------
    >>> print(calcidem.import_packing("dump.sand", "disks.csv", types=["1"]))  # doctest: +SKIP
    """
    source, out = Path(source), Path(out)
    if out.suffix.lower() != ".csv":
        raise PackingFileError(f"out = '{out}' does not end with .csv; disks are written as CSV")
    if out.exists() and out.samefile(source):
        raise PackingFileError(f"out = '{out}' is the file that is read; give another name")
    found = ForeignDisks.read(source, columns, timestep)
    factor, remarks = _metres(found, unit)
    axes = _axes(found, plane, remarks)
    place, radius = found.place[:, axes] * factor, found.radius * factor
    kept, left_out = _choose_disks(source, found, place, radius, types)
    if unit is None and not found.unit and kept.any():
        _question_unit(source, 2.0 * float(radius[kept].mean()))
    bounds = None if found.rows.box is None else found.rows.box[axes[:2]] * factor
    given = None if walls is None else factor * _walls_of(walls)
    if given is None and bounds is not None:
        across = (np.abs(place[:, :2] - bounds.mean(axis=1)) + (1.0 - LARGEST_OVERLAP) * radius[:, None])[kept]
        for side, axis in enumerate("xyz"[number] for number in axes[:2]):
            if axis in found.rows.periodic and (count := int((across[:, side] > 0.5 * np.ptp(bounds[side])).sum())):
                raise PackingFileError(
                    f"{source}: the boundary in {axis} is periodic, and {count} disks reach across it; a campaign has "
                    "walls there. Give walls = left, right, floor and lid inside the box: disks beyond are left out"
                )
    box, said = _box_of(place[kept, :2], radius[kept], bounds, given)
    if given is not None:
        gap = np.minimum(place[:, :2] - box[:, 0], box[:, 1] - place[:, :2]).min(axis=1)
        beyond = (gap < (1.0 - LARGEST_OVERLAP) * radius) & kept
        left_out += [f"{beyond.sum()} disks that reach beyond the walls"] * bool(beyond.any())
        kept &= ~beyond
    if kept.sum() < FEWEST_DISKS:
        reasons = "; ".join(("", *left_out))
        raise PackingFileError(f"{source} has {kept.sum()} disks{reasons}; at least {FEWEST_DISKS} are needed")
    x, y = (place[kept, :2] - box[:, 0]).T
    radius = radius[kept]
    refuse_deep_overlaps(source, found.lines[kept].tolist(), x, y, radius)
    pairs, overlap = overlapping_pairs(x, y, radius)
    width, height = float(np.ptp(box[0])), float(np.max(y + radius))
    strange = judge_porosity(1.0 - float(np.pi * np.sum(radius**2)) / (width * height), radius)
    if strange and strange[0].refused:
        raise PackingFileError(f"{source}: {strange[0].text}")
    remarks += [f"Check the {fault.text}." for fault in strange]
    with write_atomically(out) as temporary:
        write_disks_csv(x, y, radius, temporary)
    return ImportedPacking(
        source=source,
        out=out,
        form=found.rows.form,
        evidence=found.rows.evidence,
        x=x,
        y=y,
        radius=radius,
        width=width,
        height=height,
        origin=(float(box[0, 0]), float(box[1, 0])),
        left_out=tuple(left_out),
        remarks=(*remarks, said, *_suspicions(radius, len(pairs), deepest_overlap(x, y, radius, pairs))),
        pairs=len(pairs),
        mean_overlap=float(overlap.mean()) if len(pairs) else 0.0,
        largest_overlap=float(overlap.max(initial=0.0)),
    )


def _walls_of(walls: Sequence[float]) -> Floats:
    """Given walls [[left, right], [floor, lid]], in the source's unit."""
    given = np.asarray(walls, dtype=float)
    if given.shape != (4,) or not (np.isfinite(given).all() and given[0] < given[1] and given[2] < given[3]):
        raise PackingFileError(
            f"walls = {quote(list(walls))}: give four finite numbers, left, right, floor and lid, each pair ascending"
        )
    return given.reshape(2, 2)


def _metres(found: ForeignDisks, unit: str | None) -> tuple[float, list[str]]:
    """Source's unit in metres, and its origin."""
    chosen = found.unit or "m" if unit is None else unit
    factor = factor_of(chosen, "length")
    if np.isnan(factor):
        raise PackingFileError(f"unit = '{unit}' is none of {', '.join(UNITS['length'])}; give one of them")
    if found.unit and factor != factor_of(found.unit, "length"):
        raise PackingFileError(f"unit = '{unit}': the file has its own unit, {found.unit}; leave unit out")
    origin = "as given" if unit is not None else "as in the file" if found.unit else "since the file has none"
    return factor, [f"unit {chosen}, {origin}"]


def _question_unit(source: Path, mean: float) -> None:
    """Refuse a mean diameter, m, that is not that of a sand if nobody said that it is in m."""
    if not _is_sand(mean):
        fitting = [
            f"{name} if it is {mean:.3g} {name}" for name, one in UNITS["length"].items() if _is_sand(one * mean)
        ]
        cure = f"unit: {' or '.join(fitting) or 'm'}"
        raise PackingFileError(
            f"{source} has no unit, and a mean diameter of {mean:.3g} m is not that of a sand; {cure}"
        )


def _is_sand(diameter: float) -> bool:
    """Whether grains of a sand have such a mean diameter, m."""
    return 2e-5 <= diameter <= 0.02


def _axes(found: ForeignDisks, plane: str | None, remarks: list[str]) -> list[int]:
    """Numbers of the axes that become x, y and z; without a plane the one in which most disks lie, and a remark."""
    if plane is not None and (len(set(plane)) != 2 or not set(plane) <= set("xyz")):
        raise PackingFileError(f"plane = '{plane}' is not a pair of axes; give xy, xz or yz")
    if plane is None and not len(found.radius):  # refused later
        plane = "xy"
    if plane is None:
        flat = [2.0 * _beside_plane(found.place[:, 2 - n], found.radius).sum() <= len(found.radius) for n in range(3)]
        plane = ("xy", "xz", "yz")[flat.index(True)] if any(flat) else "xy"
        remarks += [f"plane {plane}, in which the disks lie"] * (plane != "xy")
    first, second = ("xyz".index(axis) for axis in plane)
    return [first, second, 3 - first - second]


def _beside_plane(place: Floats, radius: Floats) -> Flags:
    """Disks (N,) off the common plane, by their places across it."""
    return np.asarray(np.abs(place - np.median(place)) > 0.1 * radius)


def _choose_disks(
    source: Path, found: ForeignDisks, place: Floats, radius: Floats, types: Sequence[str]
) -> tuple[Flags, list[str]]:
    """Disks (N,) of the given types with a size, in one plane, and sentences about the others."""
    kept = np.ones(len(radius), dtype=bool)
    left_out = []
    if skipped := found.rows.skipped:
        left_out.append(f"{len(skipped)} lines that are no disks, the first of them line {skipped[0]}")
    counts = Counter(found.kinds or ())
    if strange := [kind for kind in types if kind not in counts]:
        known = ", ".join(sorted(counts)) or "none"
        raise PackingFileError(f"{source}: no disk has type = '{strange[0]}'; its types are {known}")
    for kind in sorted(set(counts) - set(types)) if types else ():
        kept &= np.array(found.kinds) != kind
        left_out.append(f"{counts[kind]} disks of type {kind}")
    if (radius < 0.0).any():
        line = found.lines[np.argmax(radius < 0.0)]
        raise PackingFileError(f"{source}, line {line}: the radius is negative; give a positive one")
    sizeless = kept & (radius == 0.0)
    left_out += [f"{sizeless.sum()} points without a size"] * bool(sizeless.any())
    kept &= ~sizeless
    if kept.any():
        aside = np.zeros_like(kept)
        aside[kept] = _beside_plane(place[kept, 2], radius[kept])
        if 2 * aside.sum() > kept.sum():
            extents = ", ".join(f"{axis} {np.ptp(found.place[kept, number]):.3g}" for number, axis in enumerate("xyz"))
            raise PackingFileError(
                f"{source}: most disks are no layer in the chosen plane (extents in its unit: {extents}); give a "
                "packing of one layer, and with plane the two axes in which it lies, such as xz"
            )
        left_out += [f"{aside.sum()} disks out of the plane of the others"] * bool(aside.any())
        kept &= ~aside
    return kept, left_out


def _box_of(place: Floats, radius: Floats, bounds: Floats | None, given: Floats | None) -> tuple[Floats, str]:
    """Walls [[left, right], [floor, lid]] in m, and their origin."""
    if given is not None:
        return given, "walls as given"
    if not len(radius):
        return np.zeros((2, 2)), ""
    touched = np.stack([(place - radius[:, None]).min(axis=0), (place + radius[:, None]).max(axis=0)], axis=1)
    step = 10.0 ** np.floor(np.log10(LARGEST_OVERLAP * radius.min()))
    rounded = np.round(touched / step) / np.round(1.0 / step) + 0.0  # no -0
    box = np.where(np.abs(rounded - touched) <= 0.01 * radius.min(), rounded, touched)  # a round number nearby
    said = "the outermost disks"
    if bounds is not None:
        fits = np.abs(bounds - touched) <= LARGEST_OVERLAP * radius.min()
        box = np.where(fits, bounds, box)
        said = "the box in the file" if fits[0].all() and fits[1, 0] else said
    return box, f"walls from {said}"


def _suspicions(radius: Floats, pairs: int, deepest: float) -> Iterator[str]:
    """Notes about suspicious values."""
    mean = 2.0 * float(radius.mean())
    if not _is_sand(mean):
        yield f"Check the unit: a mean diameter of {mean:.3g} m is not that of a sand."
    if deepest > DEEP_OVERLAP:
        yield f"The largest overlap is {deepest:.1%} of a radius; above {LARGEST_OVERLAP:.0%} disks are refused."
    if pairs < len(radius):  # below 1.5 pairs for each disk a packing is unstable
        yield "Few disks touch: the lid will compress them. Check whether the sizes are radii or diameters."
