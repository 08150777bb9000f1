"""A packing as data: what is to be made, what came out, and how far the making is (`calcidem.dem.sample.compaction`).

Whoever reads a packing comes by here, so nothing of the engine is imported.
"""

from dataclasses import dataclass
from hashlib import sha256
from typing import Annotated

import numpy as np
from annotated_types import Interval, Unit

from calcidem.dem.engine.fields import NotNegative, Positive, require, require_fields
from calcidem.dem.engine.scene import Preload
from calcidem.dem.kernels.layout import Floats, Integers

WALL_NAMES = ("left", "right", "floor", "lid")
LID = WALL_NAMES.index("lid")
PACKING_METHOD = 2
"""Raised when the same rule and generator make other packings; those of campaigns stay."""
_DIAMETERS = "(smallest, largest) in m, both positive"


class PackingError(RuntimeError):
    """The packing did not come to rest."""


class PackingFileError(PackingError):
    """A file that is no packing; the message names file, line and remedy."""


@dataclass(frozen=True, slots=True)
class PackingRule:
    """How a packing is made (paper, section 2.2.2 and Table 1).

    Attributes
    ----------
    width, height
        Size of the box before compression, m.
    diameter
        Smallest and largest diameter, m; uniformly distributed.
    porosity
        Porosity of the box before compression, which fixes the number of disks.
    expansion_steps
        Steps in which the disks grow to their size.
    friction_preparation
        Coulomb coefficient between grains during packing.
    stress
        Vertical stress on the lid, Pa.
    damping
        Local damping factor during packing.
    unbalanced_force_ratio
        Unbalanced-force ratio at which the packing is at rest.
    most_steps
        Largest number of time steps.
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
    damping: Annotated[float, Interval(gt=0.0, lt=1.0), "a factor in (0, 1): without it nothing comes to rest"] = 0.7
    unbalanced_force_ratio: Annotated[float, Interval(gt=0.0, le=1e-3)] = 1.0e-6  # above it is no equilibrium
    most_steps: Annotated[int, Interval(ge=1)] = 2_000_000

    def __post_init__(self) -> None:
        """Refuse what cannot be packed."""
        require_fields(self)
        smallest, largest = self.diameter
        require(smallest <= largest, "diameter", self.diameter, f"give {_DIAMETERS}")
        is_roomy = largest < min(self.width, self.height) / 4.0
        cure = "at least 4 disks have to fit across the box; give smaller disks, or a larger width and height"
        require(is_roomy, "diameter", self.diameter, cure, "width", "height")


@dataclass(frozen=True, slots=True)
class PackingReport:
    """What came out.

    Attributes
    ----------
    porosity
        1 - area of the disks / (width x height of the lid).
    coordination_number, coordination_number_without_rattlers
        2 contacts / disks; of all disks, and of those left when disks with fewer than 2 contacts are
        taken away again and again (Thornton 2000, doi:10.1680/geot.2000.50.1.43, does it once).
    rattlers
        Number of these.
    wall_stress
        Normal stress on left, right, floor and lid, Pa.
    mean_overlap, largest_overlap
        Of touching pairs, m.
    unbalanced_ratio
        See `readout.unbalanced_ratio`.
    steps, seconds
        Cost.
    """

    porosity: float
    coordination_number: float
    coordination_number_without_rattlers: float
    rattlers: int
    wall_stress: tuple[float, float, float, float]
    mean_overlap: float
    largest_overlap: float
    unbalanced_ratio: float
    steps: int
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Packing:
    """Disks at rest in a box, with the shear forces of their contacts; equal to itself alone.

    Attributes
    ----------
    x, y, radius
        (N,) m.
    width, height
        Inner size of the box with the lid in place, m.
    preload
        Shear forces of the touching pairs.
    report
        What came out.
    """

    x: Floats
    y: Floats
    radius: Floats
    width: float
    height: float
    preload: Preload
    report: PackingReport

    @property
    def pairs(self) -> Integers:
        """(C, 2) touching pairs."""
        return self.preload.pairs

    @property
    def content_hash(self) -> str:
        """Identity of the packing itself: SHA-256 of the bits of disks, walls and forces, 64 hexadecimal digits.

        What was measured of it (`report`) does not count: the same packing may be made twice in different times.
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


@dataclass(frozen=True, slots=True)
class PackingStage:
    """How far the making of a packing is.

    Attributes
    ----------
    expansion_step, expansion_steps
        Radius step that is being taken, from 1, and their number; one more than it while the lid presses.
    steps
        Time steps so far.
    unbalanced_ratio, target_ratio
        Unbalanced-force ratio, and the one at which the packing is at rest.
    fraction
        Part of the work that may be done: while the lid presses, by the logarithm of the smallest ratio so far.
    """

    expansion_step: int
    expansion_steps: int
    steps: int
    unbalanced_ratio: float
    target_ratio: float
    fraction: float
