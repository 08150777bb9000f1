"""Data of a packing: its rule, the result, and the progress of `calcidem.dem.sample.compaction`.

The module imports nothing of the engine, so packings can be read without it.
"""

from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Annotated

import numpy as np
from annotated_types import Interval, Unit

from calcidem.dem.engine.fields import NotNegative, Positive, checked, quote, require
from calcidem.dem.engine.scene import Preload
from calcidem.dem.kernels.layout import Floats, Integers

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
