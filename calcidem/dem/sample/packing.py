"""Data of a packing: its rule, result and plausibility, and the progress of `calcidem.dem.sample.compaction`.

A packing of any origin is judged before a wave is transmitted. The contact law holds for overlaps much smaller than the
radii, which limits stress over modulus. Geometry bounds the density and the number of neighbours. The module imports
nothing of the engine but its data, so packings can be read without it.
"""

import math
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Annotated

import numpy as np
from annotated_types import Interval, Unit

from calcidem.dem.engine.fields import NotNegative, Positive, checked, quote, require
from calcidem.dem.engine.scene import Preload, Sand
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
        Interval(ge=0.1, le=0.35),  # of a crystal; at rest it is about 0.2, and the lid moves by a fifth at most
        "a number between 0.1 and 0.35, from which the lid can press the disks together",
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
            ("x", "<f8", self.x),
            ("y", "<f8", self.y),
            ("radius", "<f8", self.radius),
            ("size", "<f8", (self.width, self.height)),
            ("pairs", "<i8", self.preload.pairs),
            ("shear", "<f8", self.preload.shear),
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


LARGEST_OVERLAP = 0.1
"""Overlap over the smaller radius above which Hertz's law fails and imported disks are considered a mistake."""
DEEP_OVERLAP = 0.07
"""Overlap over the smaller radius above which a warning is given."""


@dataclass(frozen=True, slots=True)
class _Fault:
    """Fault of a packing."""

    text: str
    """Key of ``[packing]``, value, cause and remedy."""
    refused: bool
    """True refuses the packing; False only warns."""


def expected_overlap(stress: float, diameter: float, sand: Sand) -> float:
    """Return the overlap over the radius of a contact of equal disks under a force ``stress diameter``, N/m.

    By Hertz's law, ``F = h d^1.5``. The mean overlap of packings is 0.7 to 1.2 times this value.

    Parameters
    ----------
    stress
        Pa.
    diameter
        m.
    sand
        Material of the disks, which have unit thickness.
    """
    radius = np.array([diameter / 2.0])
    coefficient = float(sand.hertz_coefficient(radius, radius)[0])
    return float(2.0 / diameter * (stress * diameter / coefficient) ** (2.0 / 3.0))


def judge_stress(stress: float, diameter: float, sand: Sand) -> str:
    """Return the text of a fault if the stress would crush a planned packing; empty if it would not.

    Parameters
    ----------
    stress
        Stress on the lid, Pa.
    diameter
        Mean diameter, m.
    sand
        Their material.
    """
    expected = expected_overlap(stress, diameter, sand)
    if expected <= 0.05:  # above this mean the largest overlap is certainly too deep
        return ""
    # The largest overlap was 1.9 to 3.9 times this in 19 packings of 390 disks, from 1e-3 to 0.3 of a radius.
    cure = _softer(3.0 * expected, stress, sand)
    return (
        f"stress = {stress:g}: presses disks of {diameter:.3g} m by {expected:.0%} of a radius into one another on "
        f"average, too much for sand.shear_modulus = {sand.shear_modulus:g}; {cure}"
    )


def judge_disks(packing: Packing, sand: Sand) -> tuple[_Fault, ...]:
    """Return the faults of a packing at rest, the worst first.

    Parameters
    ----------
    packing
        Generated or imported packing.
    sand
        Its material.
    """
    report, (left, right, floor, lid) = packing.report, packing.report.wall_stress
    stress = max(left, right, floor, lid)
    rim = np.minimum.reduce([packing.x, packing.width - packing.x, packing.y, packing.height - packing.y])
    at_walls = float(np.max(1.0 - rim / packing.radius, initial=0.0))
    deepest = max(deepest_overlap(packing.x, packing.y, packing.radius, packing.pairs), at_walls)
    found = []
    if deepest > DEEP_OVERLAP:
        cause = f"stress of {stress:.3g} Pa on a wall, too high for sand.shear_modulus = {sand.shear_modulus:g}"
        limit = f"Hertz's law holds up to {LARGEST_OVERLAP:.0%}"
        text = f"stress: the largest overlap is {deepest:.1%} of a radius, {limit} ({cause}); "
        found.append(_Fault(text + _softer(deepest, lid, sand), refused=deepest > LARGEST_OVERLAP))
    found += judge_porosity(report.porosity, packing.radius)
    contacts = report.coordination_number_without_rattlers
    too_many = contacts >= 6.0  # as many as in no planar graph (Euler)
    if too_many or contacts < 3.0:  # with friction, isostatic
        bound = "disks always have fewer than 6" if too_many else "3 are needed to resist shear"
        text = f"porosity: each disk has {contacts:.2f} contacts without rattlers; {bound}; "
        cure = "lower the stress" if too_many else "lower packing.porosity or packing.friction_preparation"
        found.append(_Fault(text + cure, refused=too_many))
    return tuple(sorted(found, key=lambda fault: not fault.refused))


def judge_porosity(porosity: float, radius: Floats) -> tuple[_Fault, ...]:
    """Return the faults of a porosity for disks of these radii (N,)."""
    densest = 1.0 - _densest_cover(float(radius.min() / radius.max()))
    if porosity < densest:
        text = (
            f"porosity: {porosity:.3f} is below {densest:.3f}, the least of disks of these sizes that do not overlap; "
            "lower the stress, raise sand.shear_modulus, or check the sizes"
        )
        return (_Fault(text, refused=True),)
    if porosity > 0.3:
        text = f"porosity: {porosity:.3f} is above 0.3; loose disks hardly carry load; lower packing.porosity"
        return (_Fault(text, refused=False),)
    return ()


def _densest_cover(ratio: float) -> float:
    """Return an upper bound of the area fraction of disks without overlap, radii from ``ratio`` to 1.

    Florian (1960), Ausfuellung der Ebene durch Kreise, Rend. Circ. Mat. Palermo 9, 300, doi:10.1007/BF02851249. For
    equal disks it is ``pi / sqrt(12)``, the hexagonal lattice.
    """
    squared = ratio * ratio
    angle = math.asin(ratio / (1.0 + ratio))
    return (math.pi * squared + 2.0 * (1.0 - squared) * angle) / (2.0 * ratio * math.sqrt(1.0 + 2.0 * ratio))


def deepest_overlap(x: Floats, y: Floats, radius: Floats, pairs: Integers) -> float:
    """Return the largest overlap of pairs (C, 2) of disks (N,), over the smaller radius; 0 without any."""
    first, second = np.asarray(pairs).T
    distance = np.hypot(x[second] - x[first], y[second] - y[first])
    overlap = (radius[first] + radius[second] - distance) / np.minimum(radius[first], radius[second])
    return float(overlap.max(initial=0.0))


def overlapping_pairs(x: Floats, y: Floats, radius: Floats) -> tuple[Integers, Floats]:
    """Return the overlapping pairs (C, 2) of disks (N,), and their overlaps (C,), m."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - what only reads stored disks does not wait for SciPy

    centres = np.column_stack([x, y])
    pairs = cKDTree(centres).query_pairs(2.0 * float(radius.max()), output_type="ndarray")
    overlap = radius[pairs].sum(axis=1) - np.linalg.norm(centres[pairs[:, 1]] - centres[pairs[:, 0]], axis=1)
    return pairs[overlap > 0.0], overlap[overlap > 0.0]


def refuse_changed(packing: Packing) -> None:
    """Refuse a stored packing whose disks do not lie in its box, or do not touch as its pairs and its report say.

    `ValueError` names the contradiction.
    """
    x, y, radius, (pairs, shear) = packing.x, packing.y, packing.radius, (packing.pairs, packing.preload.shear)
    count, contacts = len(radius), len(shear)
    if (x.shape, y.shape, pairs.shape, shear.shape) != ((count,), (count,), (contacts, 2), (contacts,)):
        raise ValueError("its arrays differ in length")
    rim = np.minimum.reduce([x, packing.width - x, y, packing.height - y])
    if not ((rim >= (1.0 - LARGEST_OVERLAP) * radius) & (radius > 0.0) & np.isfinite(rim + radius)).all():
        raise ValueError("a disk has no size or is not in the box")
    if not np.isfinite(shear).all():
        raise ValueError("a force is not finite")
    if not ((pairs >= 0) & (pairs < count)).all():
        raise ValueError("a pair has a disk that does not exist")
    touching, overlap = overlapping_pairs(x, y, radius)
    stated, found = (np.sort(listed, axis=1) @ [count, 1] for listed in (pairs, touching))
    if len(np.unique(stated)) < contacts:
        raise ValueError("a pair is listed twice")
    differ = np.stack(np.divmod(np.setxor1d(stated, found), count), axis=1)
    gap = radius[differ].sum(axis=1) - np.hypot(*(values[differ[:, 0]] - values[differ[:, 1]] for values in (x, y)))
    if (np.abs(gap) > 1e-12 * radius.max()).any():  # a disk just touches another, or not
        raise ValueError(f"{contacts} pairs are said to touch, and {len(touching)} do")
    if not np.isclose(overlap.mean(), packing.report.mean_overlap, rtol=1e-8, atol=1e-13 * radius.max()):
        raise ValueError(f"its mean overlap is {overlap.mean():g} m, not {packing.report.mean_overlap:g} m")


def _softer(deepest: float, stress: float, sand: Sand) -> str:
    """Propose a stress and a modulus for an overlap of 5 % of the radius; it scales with (stress / modulus)^(2/3)."""
    factor = (deepest / 0.05) ** 1.5
    return (
        f"packing.stress = {stress / factor:.2g} Pa or sand.shear_modulus = {sand.shear_modulus * factor:.2g} Pa gives "
        "about 5%"
    )
