"""Data of a packing: its rule, the result, and the progress of `calcidem.dem.sample.compaction`.

The module imports nothing of the engine, so packings can be read without it.
"""

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Interval, Unit

from calcidem.dem.engine.fields import NotNegative, Positive, checked, quote, require
from calcidem.dem.engine.scene import Preload, Sand, Scene
from calcidem.dem.kernels.layout import Floats, Integers
from calcidem.dem.sample.compaction import OWN_DISKS, Cost, box_walls, press
from calcidem.dem.sample.judgement import LARGEST_OVERLAP, overlapping_pairs
from calcidem.input_file import MOST_BYTES, read_input
from calcidem.table import Table, unit_in_name, value_of

WALL_NAMES = ("left", "right", "floor", "lid")
RIGHT, LID = WALL_NAMES.index("right"), WALL_NAMES.index("lid")
PACKING_METHOD = 2
"""Increased when the same rule and generator produce other packings; those of campaigns stay."""


class PackingError(RuntimeError):
    """The packing did not come to rest."""


class PackingFileError(PackingError):
    """File without a valid packing; the message names file, line and remedy."""


@checked
@dataclass(frozen=True, slots=True)
class PackingRule:
    """Rule of a packing (paper, section 2.2.2 and Table 1).

    Attributes
    ----------
    width, height
        Size of the box before compression, m.
    diameter
        Diameters, uniformly distributed, m.
    porosity
        Porosity before compression, which determines the number of disks.
    expansion_steps
        Steps of radius expansion.
    friction_preparation
        Coulomb coefficient between grains during packing.
    stress
        Vertical stress on the lid, Pa.
    lateral_stress_ratio
        Horizontal stress on the right side over that on the lid, held by a servo, too: 1 is isotropic. Without it the
        sides stand, and the sample determines the ratio, as in an oedometer.
    damping
        Local damping factor during packing.
    unbalanced_force_ratio
        Unbalanced-force ratio that defines rest.
    most_steps
        Most time steps.
    """

    width: Annotated[Positive, Unit("m")] = 0.1
    height: Annotated[Positive, Unit("m")] = 0.3
    diameter: Annotated[tuple[Positive, Positive], Unit("m"), "(smallest, largest) in m, both positive"] = (
        2.12e-3,
        3e-3,
    )
    porosity: Annotated[
        float,
        Interval(ge=0.1, le=0.5),  # between crystal and gas
        "a number between 0.1 and 0.5, where two-dimensional packings lie",
    ] = 0.192
    expansion_steps: Annotated[int, Interval(ge=1, le=100)] = 5
    friction_preparation: NotNegative = 0.2
    stress: Annotated[Positive, Unit("Pa")] = 5.0e3
    lateral_stress_ratio: (
        Annotated[float, Interval(ge=0.1, le=10.0), "a ratio between 0.1 and 10; leave it out if the sides stand"]
        | None
    ) = None
    damping: Annotated[float, Interval(gt=0.0, lt=1.0), "a factor in (0, 1): without it disks never come to rest"] = 0.7
    unbalanced_force_ratio: Annotated[float, Interval(gt=0.0, le=1e-3)] = 1.0e-6  # no equilibrium above this
    most_steps: Annotated[int, Interval(ge=1)] = 2_000_000

    def __post_init__(self) -> None:
        """Refuse impossible packings."""
        smallest, largest = self.diameter
        require(smallest <= largest, "diameter", quote(self.diameter), "give (smallest, largest) in m, both positive")
        is_roomy = largest < min(self.width, self.height) / 4.0
        cure = "at least 4 disks must fit across the box; give smaller disks, or a larger width and height"
        require(is_roomy, "diameter", quote(self.diameter), cure, "width", "height")


@dataclass(frozen=True, slots=True)
class PackingReport:
    """Result of packing."""

    porosity: float
    """1 - area of the disks / (width x height of the lid)."""
    coordination_number: float
    coordination_number_without_rattlers: float
    """2 contacts / disks, for all disks and for those left after repeated removal of disks with fewer than 2 contacts
    (Thornton 2000, doi:10.1680/geot.2000.50.1.43, removes them once).
    """
    rattlers: int
    """Number of removed disks."""
    wall_stress: tuple[float, float, float, float]
    """Normal stress on left, right, floor and lid, Pa."""
    mean_overlap: float
    largest_overlap: float
    """Overlap of touching pairs, m."""
    unbalanced_ratio: float
    """See `readout.unbalanced_ratio`."""
    steps: int
    seconds: float
    """Time steps and wall time, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Packing:
    """Disks at rest in a box, with the shear forces of their contacts; compared by identity."""

    x: Floats
    y: Floats
    radius: Floats
    """(N,) m."""
    width: float
    height: float
    """Inner size of the box with the lid in place, m."""
    preload: Preload
    """Shear forces of the touching pairs."""
    report: PackingReport
    """Result of packing."""

    @property
    def pairs(self) -> Integers:
        """(C, 2) touching pairs."""
        return self.preload.pairs

    @property
    def content_hash(self) -> str:
        """SHA-256 of the bits of disks, walls and forces, 64 hexadecimal digits.

        The `report` does not count, since the same packing may take different times.
        """
        digest = sha256(b"calcidem packing content 1\n")
        for name, kind, values in (
            *(("x", "<f8", self.x), ("y", "<f8", self.y), ("radius", "<f8", self.radius)),
            ("size", "<f8", (self.width, self.height)),
            *(("pairs", "<i8", self.preload.pairs), ("shear", "<f8", self.preload.shear)),
        ):
            array = np.asarray(values, dtype=kind)
            digest.update(f"{name} {kind} {array.shape}\n".encode())
            digest.update(array.tobytes())
        return digest.hexdigest()

    def mirrored(self) -> "Packing":
        """The packing with left and right exchanged; disks and pairs keep their numbers."""
        left, right, floor, lid = self.report.wall_stress
        return replace(
            self,
            x=self.width - self.x,
            preload=replace(self.preload, shear=-self.preload.shear),
            report=replace(self.report, wall_stress=(right, left, floor, lid)),
        )


@dataclass(frozen=True, slots=True)
class PackingStage:
    """Progress of packing."""

    expansion_step: int
    expansion_steps: int
    """Current radius step, from 1, and number of radius steps; one step more while the lid presses."""
    steps: int
    """Time steps so far."""
    fraction: float
    """Estimated part of the work done; under the lid from the logarithm of the smallest ratio so far."""


_CSV_COLUMNS = ("x", "y", "radius")
_KNOWN = {"x": "x", "y": "y", "radius": "r|radius"}
FEWEST_DISKS = 10
FARTHEST = 1e30
"""m; keeps distances of disks and their squares finite."""


def write_packing_csv(packing: Packing, file: Path) -> None:
    """Write the disks of a packing, see `write_disks_csv`."""
    write_disks_csv(packing.x, packing.y, packing.radius, file)


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
    _check_walls(file, lines, x, y, radius, float(np.max(x + radius)) if width is None else width)
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


def _check_walls(file: Path, lines: list[int], x: Floats, y: Floats, radius: Floats, width: float) -> None:
    """Refuse disks that extend beyond the box."""
    for wall, gap in (("left wall", x), ("right wall", width - x), ("floor", y)):
        out = np.flatnonzero(gap < (1.0 - LARGEST_OVERLAP) * radius)
        if len(out):
            disk = out[0]
            beyond = radius[disk] - gap[disk]
            raise PackingFileError(
                f"{file}, line {lines[disk]}: the disk at ({x[disk]:g}, {y[disk]:g}) m reaches {beyond:.3g} m beyond "
                f"the {wall}; move the disks into 0 < x < {width:g} m, 0 < y, or change width"
            )


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
