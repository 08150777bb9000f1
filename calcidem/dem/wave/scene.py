"""Scene of a shear wave: a cemented packing between transmitter and receiver, and its computed part.

Transmitter and receiver are bands of the side walls at mid-height. Strongly damped layers at floor and lid represent
the soil beyond (section 2.2.2 and Fig. 4 of the paper).

Disks that the wave cannot reach are left out. A layer with a local damping factor of 1 removes any force that
accelerates a disk, so a wave decays within a few diameters. At a depth of four diameters, a billionth of the pulse's
stroke remains at every content. Deeper disks only cost time, as do disks without contacts if none can form.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calcidem.dem.engine.fields import require
from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.engine.scene import Bonds, Installation, Preload, Scene, Wall
from calcidem.dem.kernels.layout import Flags, Integers
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.rule import WHOLE_DOMAIN, WaveRule

TRANSMITTER, RECEIVER = 1, 4  # indices of the walls of `wave_scene`
DEEPEST_LISTENING = 0.3
"""Largest listening depth over box width; beyond it, velocities in a lattice are over 10 % high (docs/velocity.md)."""


def wave_scene(packing: Packing, sand: Sand, rule: WaveRule, bonds: Bonds | None) -> Scene:
    """The packing between transmitter and receiver."""
    width, height, middle = packing.width, packing.height, packing.height / 2.0
    for name in ("transmitter_half_width", "receiver_half_width"):
        half = getattr(rule, name)
        require(half < middle, name, half, f"has to be less than half the height of the sample, {middle:.4g} m")
    require(
        rule.boundary_thickness < middle,
        "boundary_thickness",
        rule.boundary_thickness,
        f"has to be less than half the height of the sample, {middle:.4g} m",
    )
    rubbing = rule.band_friction if rule.transmitter == "wall" else 0.0
    transmitter, receiver = rule.transmitter_half_width, rule.receiver_half_width
    walls = (
        # The tangent of the left wall points up, of the right wall down; both start at mid-height.
        Wall((0.0, middle), (1.0, 0.0), span=(-np.inf, -transmitter)),
        Wall((0.0, middle), (1.0, 0.0), friction=rubbing, span=(-transmitter, transmitter)),
        Wall((0.0, middle), (1.0, 0.0), span=(transmitter, np.inf)),
        Wall((width, middle), (-1.0, 0.0), span=(receiver, np.inf)),
        Wall((width, middle), (-1.0, 0.0), friction=rule.band_friction, span=(-receiver, receiver)),
        Wall((width, middle), (-1.0, 0.0), span=(-np.inf, -receiver)),
        Wall((0.0, 0.0), (0.0, 1.0)),
        # The servo of the lid is active only while a cemented sample settles.
        Wall((0.0, height), (0.0, -1.0), servo_force=packing.report.wall_stress[-1] * width),
    )
    inside = np.abs(packing.y - middle) < middle - rule.boundary_thickness
    return Scene(
        x=packing.x,
        y=packing.y,
        radius=packing.radius,
        sand=sand,
        walls=walls,
        bonds=bonds,
        damping=np.where(inside, rule.damping, rule.boundary_damping),
    )


def lane_bonds(
    packing: Packing, cement: Cement, bonded: Sequence[Flags], lanes: int, installation: Installation
) -> Bonds | None:
    """Cement of all lanes as one set of bonds; None if no sample has any."""
    # Spare lanes repeat the first sample, so all lanes compute valid numbers.
    filled = [*bonded, *[bonded[0]] * (lanes - len(bonded))]
    bits = sum(np.asarray(flags, dtype=np.uint32) << np.uint32(lane) for lane, flags in enumerate(filled))
    cemented = np.flatnonzero(bits)
    if not len(cemented):
        return None
    return Bonds(packing.pairs[cemented], cement, np.asarray(bits)[cemented], installation)


@dataclass(frozen=True, slots=True)
class Domain:
    """Computed disks."""

    packing: Packing
    """Only these disks, in the whole box."""
    pairs: Integers
    """(C,) pairs of the whole packing that lie between computed disks."""
    held: Flags
    """(N,) computed disks that touch one left out; they stay in place."""


def domain_of(packing: Packing, rule: WaveRule, installation: Installation) -> Domain:
    """Disks that a wave can reach, and listening disks.

    Parameters
    ----------
    packing, rule
        Packing and wave. The whole packing is kept if the layers damp by less than 1 or the rule requires it.
    installation
        Installation of the bonds. If it changes the contact forces, the whole packing settles again.
    """
    count = len(packing.x)
    if WHOLE_DOMAIN in rule.keep or installation != "preserve":
        return Domain(packing, np.arange(len(packing.pairs)), np.zeros(count, dtype=bool))
    kept = np.ones(count, dtype=bool)
    if rule.boundary_damping >= 1.0:
        # Six mean diameters of a damping layer are computed; after four, a billionth of the stroke remains.
        middle, bands = packing.height / 2.0, max(rule.transmitter_half_width, rule.receiver_half_width)
        reach = max(middle - rule.boundary_thickness, bands) + 6.0 * 2.0 * float(packing.radius.mean())
        kept = np.asarray(np.abs(packing.y - middle) < reach)
    if rule.regime != "finite":
        kept &= np.bincount(packing.pairs.ravel(), minlength=count) > 0
    kept[listening_disks(packing, rule)] = True
    inside = kept[packing.pairs]
    pairs = np.flatnonzero(inside.all(axis=1))
    held = np.zeros(count, dtype=bool)
    held[packing.pairs[~inside.all(axis=1)].ravel()] = True
    number = np.cumsum(kept) - 1
    part = replace(
        packing,
        x=packing.x[kept],
        y=packing.y[kept],
        radius=packing.radius[kept],
        preload=Preload(number[packing.pairs[pairs]], packing.preload.shear[pairs]),
    )
    return Domain(part, pairs, held[kept])


def listening_disks(packing: Packing, rule: WaveRule) -> Integers:
    """Disks in the receiver's band that are near the wall but do not touch it.

    `ValueError` if there is none, or if disks far from the wall would blur the arrival.
    """
    depth, deepest = rule.listening_depth, DEEPEST_LISTENING * packing.width
    require(
        depth <= deepest,
        "listening_depth",
        depth,
        f"the wave reaches disks so far apart at different times; give at most {DEEPEST_LISTENING:g} of the box's "
        f"width, {deepest:.4g} m",
    )
    gap = packing.width - packing.x - packing.radius
    in_band = np.abs(packing.y - packing.height / 2.0) < rule.receiver_half_width
    found = np.flatnonzero(in_band & (gap > 0.0) & (packing.width - packing.x < depth))
    cure = "holds no disk at the receiver: make it or receiver_half_width larger"
    require(len(found) > 0, "listening_depth", depth, cure)
    return found


def station_disks(packing: Packing, rule: WaveRule) -> tuple[Integers, ...]:
    """Disks of each station, starting at the transmitter: slices of equal thickness before the listening disks.

    There are 9 of them, fewer if slices would be thinner than the largest disk, and none if one would be empty. The
    first eighth of the path is left out, because P and S wave have not separated there.
    """
    begin, end = 0.125 * packing.width, packing.width - rule.listening_depth
    count = min(9, max(0, int((end - begin) / (2.0 * float(packing.radius.max())))))  # 18 improve no reading
    in_band = np.abs(packing.y - packing.height / 2.0) < rule.receiver_half_width
    slices = pairwise(np.linspace(begin, end, count + 1))
    found = tuple(np.flatnonzero(in_band & (a <= packing.x) & (packing.x < b)) for a, b in slices)
    return found if all(map(len, found)) else ()


def driven_disks(packing: Packing, rule: WaveRule) -> Integers:
    """Disks with prescribed motion: those that overlap the left wall within the transmitter's band.

    The reference geometry at rest decides, so they are the same in all samples of a packing. Empty if the wall itself
    is the transmitter. `ValueError` if no disk touches the band.
    """
    if rule.transmitter == "wall":
        return np.zeros(0, dtype=np.int64)
    in_band = np.abs(packing.y - packing.height / 2.0) < rule.transmitter_half_width
    found = np.flatnonzero(in_band & (packing.x < packing.radius))
    cure = "no disk touches the transmitter: make it wider"
    require(len(found) > 0, "transmitter_half_width", rule.transmitter_half_width, cure)
    return found
