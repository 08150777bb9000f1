"""Whether a packing can be that of a sand: rules for packings of any origin, before a wave is transmitted.

The contact law holds for overlaps that are small against the radii, so stress over modulus decides. Two more bounds are
geometry: how densely disks can lie, and how many neighbours they can have.
"""

import math
from dataclasses import dataclass

import numpy as np

from calcidem.dem.engine.material import Sand
from calcidem.dem.kernels.layout import Floats, Integers
from calcidem.dem.sample.packing import Packing

LARGEST_OVERLAP = 0.1
"""Of the smaller radius: above it, Hertz's law does not hold, and disks of a file are a mistake rather than a load."""
DEEP_OVERLAP = 0.07
"""Of the smaller radius: above it, a packing is warned of."""
_WANTED = 0.05  # largest overlap over radius that a proposed value aims at
_MOST_EXPECTED = (
    0.05  # expected overlap of a mean contact over the radius, above which the largest one is surely too deep
)
_LARGEST_OVER_EXPECTED = 3.0  # 1.9 to 3.9 in 19 packings of 390 disks, from 1e-3 to 0.3 of a radius
_ISOSTATIC = 3.0
"""Contacts per disk, rattlers left out, below which a packing with friction has no stiffness against shear."""
_PLANAR = 6.0  # contacts per disk that a planar graph stays below (Euler)
_LOOSEST = 0.3  # porosity of packings that hardly carry load


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong with a packing.

    Attributes
    ----------
    key
        Key of ``[packing]`` that the text begins with.
    text
        Key, value, cause and remedy.
    refused
        Whether the packing is refused; otherwise it is a warning.
    """

    key: str
    text: str
    refused: bool


def expected_overlap(stress: float, diameter: float, sand: Sand) -> float:
    """Return the overlap over the radius of a contact that bears ``stress diameter``, N/m, between equal disks.

    Hertz's law, ``F = h d^1.5``. The mean overlap of packings is 0.7 to 1.2 of it.

    Parameters
    ----------
    stress
        Pa.
    diameter
        m.
    sand
        Material of disks of unit thickness.
    """
    radius = np.array([diameter / 2.0])
    coefficient = float(sand.hertz_coefficient(radius, radius)[0])
    return float(2.0 / diameter * (stress * diameter / coefficient) ** (2.0 / 3.0))


def judge_stress(stress: float, diameter: float, sand: Sand) -> Fault | None:
    """Return what is wrong with a packing that is yet to be made: a stress that crushes it.

    Parameters
    ----------
    stress
        On the lid, Pa.
    diameter
        Mean of the disks, m.
    sand
        Their material.
    """
    expected = expected_overlap(stress, diameter, sand)
    if expected <= _MOST_EXPECTED:
        return None
    cure = _softer(_LARGEST_OVER_EXPECTED * expected, stress, sand)
    text = (
        f"stress = {stress:g}: presses disks of {diameter:.3g} m by {expected:.0%} of a radius into one another on "
        f"average, too much for sand.shear_modulus = {sand.shear_modulus:g}; {cure}"
    )
    return Fault("stress", text, refused=True)


def judge_disks(packing: Packing, sand: Sand) -> tuple[Fault, ...]:
    """Return what is wrong with a packing at rest, the worst first.

    Parameters
    ----------
    packing
        Made or imported.
    sand
        Material that it was packed with.
    """
    report, (left, right, floor, lid) = packing.report, packing.report.wall_stress
    stress = max(left, right, floor, lid)
    deepest = max(deepest_overlap(packing.x, packing.y, packing.radius, packing.pairs), _deepest_at_walls(packing))
    found = []
    if deepest > DEEP_OVERLAP:
        cause = f"stress of {stress:.3g} Pa on a wall, too high for sand.shear_modulus = {sand.shear_modulus:g}"
        limit = f"at most {LARGEST_OVERLAP:.0%} is Hertz's law good for"
        text = f"stress: the largest overlap is {deepest:.1%} of a radius, {limit} ({cause}); "
        found.append(Fault("stress", text + _softer(deepest, lid, sand), refused=deepest > LARGEST_OVERLAP))
    found += judge_porosity(report.porosity, packing.radius)
    contacts = report.coordination_number_without_rattlers
    if contacts >= _PLANAR or contacts < _ISOSTATIC:
        bound = (
            "fewer than 6 is the most that disks can have" if contacts >= _PLANAR else "3 are needed to resist shear"
        )
        text = f"porosity: each disk has {contacts:.2f} contacts without rattlers; {bound}; "
        cure = "lower the stress" if contacts >= _PLANAR else "lower packing.porosity or packing.friction_preparation"
        found.append(Fault("porosity", text + cure, refused=contacts >= _PLANAR))
    return tuple(sorted(found, key=lambda fault: not fault.refused))


def judge_porosity(porosity: float, radius: Floats) -> tuple[Fault, ...]:
    """Return what is wrong with the porosity of disks with these radii (N,)."""
    densest = 1.0 - _densest_cover(float(radius.min() / radius.max()))
    if porosity < densest:
        text = (
            f"porosity: {porosity:.3f} is below {densest:.3f}, the least of disks of these sizes that do not overlap; "
            "lower the stress, raise sand.shear_modulus, or check the sizes"
        )
        return (Fault("porosity", text, refused=True),)
    if porosity > _LOOSEST:
        text = (
            f"porosity: {porosity:.3f} is above {_LOOSEST:g}; so loose they hardly carry load; lower packing.porosity"
        )
        return (Fault("porosity", text, refused=False),)
    return ()


def _densest_cover(ratio: float) -> float:
    """Return the largest part of a plane that disks cover without overlap, radii from ``ratio`` to 1.

    Florian (1960), Ausfuellung der Ebene durch Kreise, Rend. Circ. Mat. Palermo 9, 300, doi:10.1007/BF02851249: an
    upper bound; ``pi / sqrt(12)``, the hexagonal lattice, for equal disks.
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


def _deepest_at_walls(packing: Packing) -> float:
    """Return the largest overlap of a disk and a wall, over the radius; 0 without any."""
    distance = np.minimum.reduce([packing.x, packing.width - packing.x, packing.y, packing.height - packing.y])
    return float(np.max(1.0 - distance / packing.radius, initial=0.0))


def _softer(deepest: float, stress: float, sand: Sand) -> str:
    """Return values that bring an overlap to the one that is wanted: it goes with the power 2/3 of stress / modulus."""
    factor = (deepest / _WANTED) ** 1.5
    return (
        f"packing.stress = {stress / factor:.2g} Pa or sand.shear_modulus = {sand.shear_modulus * factor:.2g} Pa gives "
        f"about {_WANTED:.0%}"
    )
