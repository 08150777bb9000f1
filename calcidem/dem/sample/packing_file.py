"""Packings as CSV files: export to other programs, and import of own disks."""

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from calcidem.dem.engine.scene import Sand, Scene
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.compaction import OWN_DISKS, Cost, box_walls, press
from calcidem.dem.sample.packing import (
    LARGEST_OVERLAP,
    Packing,
    PackingFileError,
    PackingRule,
    PackingStage,
    overlapping_pairs,
)
from calcidem.input_file import MOST_BYTES, Table, read_input, unit_in_name, value_of

_CSV_COLUMNS = ("x", "y", "radius")
_KNOWN = {"x": "x", "y": "y", "radius": "r|radius"}
FEWEST_DISKS = 10
FARTHEST = 1e30
"""m; keeps distances of disks and their squares finite."""


def write_disks_csv(x: Floats, y: Floats, radius: Floats, file: Path) -> None:
    """Write disks: a header line, then x, y and radius (N,) of each in m, without loss of digits."""
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(_CSV_COLUMNS)
        writer.writerows(zip(x.tolist(), y.tolist(), radius.tolist(), strict=True))


def packing_from_csv(
    file: Path,
    sand: Sand,
    rule: PackingRule,
    raise_if_stopped: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """Make a packing from the disks in a file.

    The disks are checked and put into a box of the rule's width with the lid on the highest disk. They are relaxed
    under the lid's stress like the last stage of `calcidem.dem.sample.compaction.make_packing`. A file has no contact
    forces, and its positions balance another contact law at best. `PackingFileError` if the file cannot be read as
    disks, or disks overlap or leave the box by more than a tenth of a radius; `PackingError` if they do not come to
    rest.

    Parameters
    ----------
    file
        Table with a header line naming the columns x, y and radius, in m unless their names have a unit; floor and left
        wall are at 0. Further columns and lines that begin with ``#`` are ignored.
    sand
        Material; the rule's friction of preparation replaces its own while the disks come to rest.
    rule
        Its width, stresses, damping and unbalanced-force ratio apply; the file determines sizes and porosity.
    raise_if_stopped
        Called every fraction of a second; may raise to end the work.
    watch
        Called as often with the progress.
    """
    x, y, radius, _ = checked_disks(file, rule.width)
    height = float(np.max(y + radius))
    boxed = replace(rule, height=height)
    slippery = replace(sand, friction=rule.friction_preparation)
    cost = Cost(watch=watch, expansion_step=1)
    scene = Scene(x, y, radius, slippery, box_walls(rule.width, height), damping=rule.damping)
    return press(scene, None, boxed, cost, raise_if_stopped, OWN_DISKS)


def checked_disks(file: Path, width: float | None = None) -> tuple[Floats, Floats, Floats, str]:
    """Return x, y, radius (N,) of the disks in a file, and its SHA-256; refuse deep overlaps of disks and walls.

    Without a width, m, the rightmost disk touches the right wall. `PackingFileError` names the line; `InputFileError`
    if the file cannot be read as text.
    """
    x, y, radius, lines, digest = _read_disks(file)
    width = float(np.max(x + radius)) if width is None else width
    for wall, gap in (("left wall", x), ("right wall", width - x), ("floor", y)):
        out = np.flatnonzero(gap < (1.0 - LARGEST_OVERLAP) * radius)
        if len(out):
            disk = out[0]
            beyond = radius[disk] - gap[disk]
            raise PackingFileError(
                f"{file}, line {lines[disk]}: the disk at ({x[disk]:g}, {y[disk]:g}) m reaches {beyond:.3g} m beyond "
                f"the {wall}; move the disks into 0 < x < {width:g} m, 0 < y, or change width"
            )
    refuse_deep_overlaps(file, lines, x, y, radius)
    return x, y, radius, digest


def _read_disks(file: Path) -> tuple[Floats, Floats, Floats, list[int], str]:
    """Return x, y, radius (N,) and line of each disk in the file, and the file's SHA-256; as `checked_disks`."""
    content = read_input(file, MOST_BYTES)
    table = Table.read(content, file, _KNOWN, _CSV_COLUMNS)
    rows = list(_numbered_disks(file, table))
    if len(rows) < FEWEST_DISKS:
        raise PackingFileError(f"{file} has {len(rows)} disks; give at least {FEWEST_DISKS}")
    numbers, values = zip(*rows, strict=True)
    x, y, radius = np.array(values).T
    return x.copy(), y.copy(), radius.copy(), list(numbers), sha256(content).hexdigest()


def _numbered_disks(file: Path, table: Table) -> Iterator[tuple[int, tuple[float, float, float]]]:
    """Yield the line number and x, y, radius of each disk."""
    columns = table.places(_KNOWN)
    if missing := [name for name in _CSV_COLUMNS if name not in columns]:
        raise PackingFileError(f"{file} has no column {', '.join(missing)}; its first line must name x, y and radius")
    places = [(columns[name], unit_in_name(table.names[columns[name]], "length")[1] or "m") for name in _CSV_COLUMNS]
    for number, row in table.rows:
        try:
            x, y, radius = (value_of(row[place], "length", unit) for place, unit in places)
        except IndexError:
            x = y = radius = np.nan
        if np.isnan([x, y, radius]).any():
            shown = ",".join(row)
            shown = f"{shown[:80]}{'...' if len(shown) > 80 else ''}"
            raise PackingFileError(f"{file}, line {number}: '{shown}' is not a disk; give three numbers in m")
        if not (abs(x) <= FARTHEST and abs(y) <= FARTHEST and 1.0 / FARTHEST <= radius <= FARTHEST):
            raise PackingFileError(
                f"{file}, line {number}: x = {x:g}, y = {y:g}, radius = {radius:g}; give finite numbers and a positive "
                f"radius, in m, up to {FARTHEST:g}"
            )
        yield number, (x, y, radius)


def refuse_deep_overlaps(file: Path, lines: Sequence[int], x: Floats, y: Floats, radius: Floats) -> None:
    """Refuse disks that overlap by more than a tenth of a radius.

    `PackingFileError` names the lines of a pair.
    """
    pairs, overlap = overlapping_pairs(x, y, radius)
    deep = np.flatnonzero(overlap > LARGEST_OVERLAP * radius[pairs].min(axis=1))
    if len(deep):
        first, second = sorted(lines[disk] for disk in pairs[deep[0]])
        raise PackingFileError(
            f"{file}, lines {first} and {second}: the disks overlap by {overlap[deep[0]]:.3g} m, more than a tenth of "
            "a radius; move them apart, or make them smaller"
        )
