"""Import of disks of another program into a file for ``[packing] file``, with a report."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calcidem.app.disks.foreign_disks import ForeignDisks
from calcidem.dem.kernels.layout import Flags, Floats
from calcidem.dem.sample.judgement import (
    DEEP_OVERLAP,
    LARGEST_OVERLAP,
    deepest_overlap,
    judge_porosity,
    overlapping_pairs,
)
from calcidem.dem.sample.packing import PackingFileError
from calcidem.dem.sample.packing_file import FEWEST_DISKS, refuse_deep_overlaps, write_disks_csv
from calcidem.storage.files import write_atomically
from calcidem.table import UNITS, factor_of


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
    bounds = None if found.box is None else found.box[axes[:2]] * factor
    given = None if walls is None else factor * np.asarray(walls, dtype=float).reshape(2, 2)
    if given is None and bounds is not None:
        across = (np.abs(place[:, :2] - bounds.mean(axis=1)) + (1.0 - LARGEST_OVERLAP) * radius[:, None])[kept]
        for side, axis in enumerate("xyz"[number] for number in axes[:2]):
            if axis in found.periodic and (count := int((across[:, side] > 0.5 * np.ptp(bounds[side])).sum())):
                raise PackingFileError(
                    f"{source}: the boundary in {axis} is periodic, and {count} disks reach across it; a campaign has "
                    "walls there. Give walls = left, right, floor and lid inside the box: disks beyond are left out"
                )
    box, said = _box_of(place[kept, :2], radius[kept], bounds, given)
    if given is not None:
        beyond = _reach_beyond(place, radius, box) & kept
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
    with write_atomically(out) as temporary:
        write_disks_csv(x, y, radius, temporary)
    return ImportedPacking(
        source=source,
        out=out,
        form=found.form,
        evidence=found.evidence,
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


def _metres(found: ForeignDisks, unit: str | None) -> tuple[float, list[str]]:
    """Source's unit in metres, and its origin."""
    chosen = found.unit or "m" if unit is None else unit
    factor = factor_of(chosen, "length")
    if np.isnan(factor):
        raise PackingFileError(f"unit = '{unit}' is none of {', '.join(UNITS['length'])}; give one of them")
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
    if found.skipped:
        left_out.append(f"{len(found.skipped)} lines that are no disks, the first of them line {found.skipped[0]}")
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
        if not (np.diff(given) > 0.0).all():
            raise PackingFileError("walls have to be left, right, floor and lid, each pair from low to high")
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


def _reach_beyond(place: Floats, radius: Floats, box: Floats) -> Flags:
    """Disks (N,) that overlap a wall or the lid too deeply."""
    gap = np.minimum(place[:, :2] - box[:, 0], box[:, 1] - place[:, :2]).min(axis=1)
    return np.asarray(gap < (1.0 - LARGEST_OVERLAP) * radius)


def _suspicions(radius: Floats, pairs: int, deepest: float) -> Iterator[str]:
    """Notes about suspicious values."""
    mean = 2.0 * float(radius.mean())
    if not _is_sand(mean):
        yield f"Check the unit: a mean diameter of {mean:.3g} m is not that of a sand."
    if deepest > DEEP_OVERLAP:
        yield f"The largest overlap is {deepest:.1%} of a radius; above {LARGEST_OVERLAP:.0%} disks are refused."
    if pairs < len(radius):  # below 1.5 pairs for each disk a packing is unstable
        yield "Few disks touch: the lid will compress them. Check whether the sizes are radii or diameters."
