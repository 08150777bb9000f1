"""The part of a packing that takes part in a wave: disks that nothing can reach are left out.

A layer with a local damping factor of 1 removes any force that accelerates a disk, so a wave decays within a few
diameters: at a depth of four, a billionth of the pulse's stroke is left, at every content. What lies deeper only costs
time. So do disks without a contact, as long as no contact can form.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calcidem.dem.engine.fields import require
from calcidem.dem.engine.scene import Installation, Preload
from calcidem.dem.kernels.layout import Flags, Integers
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.rule import WHOLE_DOMAIN, WaveRule

DEEPEST_LISTENING = 0.3
"""Listening depth over the width of the box; beyond, a lattice is read more than 10 % too fast (docs/reading.md)."""

_STATIONS = 9
"""Slices of the sample between transmitter and receiver whose motion is recorded; with 18 no reading improves."""

_NEAR_TRANSMITTER = 0.125  # of the width: no station is nearer

_DEPTH = 6.0  # mean diameters of a damping layer that are kept


@dataclass(frozen=True, slots=True)
class Domain:
    """Disks that are computed.

    Attributes
    ----------
    packing
        They alone, in the whole box.
    pairs
        (C,) which of the pairs of the whole packing they have among themselves.
    held
        (N,) of the disks that are computed: those that lean on one left out. They keep their places.
    """

    packing: Packing
    pairs: Integers
    held: Flags


def domain_of(packing: Packing, rule: WaveRule, installation: Installation) -> Domain:
    """Disks that a wave can reach, and those that listen.

    Parameters
    ----------
    packing, rule
        What the wave crosses, and how. The whole packing is kept where the layers damp by less than 1, and
        where the rule says so.
    installation
        Of the bonds. Those that change the contact forces let the whole packing settle anew.
    """
    count = len(packing.x)
    if WHOLE_DOMAIN in rule.keep or installation != "preserve":
        return Domain(packing, np.arange(len(packing.pairs)), np.zeros(count, dtype=bool))
    kept = _within_reach(packing, rule)
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
    """Disks in the receiver's band, near the wall but not touching it.

    `ValueError` if there is none, or if those that are far from the wall would blur the arrival.
    """
    depth, deepest = rule.listening_depth, DEEPEST_LISTENING * packing.width
    require(
        depth <= deepest,
        "listening_depth",
        depth,
        f"disks so far apart hear the wave at times of their own; give at most {DEEPEST_LISTENING:g} of the box's "
        f"width, {deepest:.4g} m",
    )
    gap = packing.width - packing.x - packing.radius
    in_band = np.abs(packing.y - packing.height / 2.0) < rule.receiver_half_width
    found = np.flatnonzero(in_band & (gap > 0.0) & (packing.width - packing.x < depth))
    cure = "holds no disk at the receiver: make it or receiver_half_width larger"
    require(len(found) > 0, "listening_depth", depth, cure)
    return found


def station_disks(packing: Packing, rule: WaveRule) -> tuple[Integers, ...]:
    """Disks of each station, from the transmitter on: slices of one thickness before the disks that listen.

    There are `_STATIONS` of them, fewer where slices would be thinner than the largest disk, and none where one would
    be empty. The first part of the path is left out: there P and S wave are one.
    """
    begin, end = _NEAR_TRANSMITTER * packing.width, packing.width - rule.listening_depth
    count = min(_STATIONS, max(0, int((end - begin) / (2.0 * float(packing.radius.max())))))
    in_band = np.abs(packing.y - packing.height / 2.0) < rule.receiver_half_width
    slices = pairwise(np.linspace(begin, end, count + 1))
    found = tuple(np.flatnonzero(in_band & (a <= packing.x) & (packing.x < b)) for a, b in slices)
    return found if all(map(len, found)) else ()


def driven_disks(packing: Packing, rule: WaveRule) -> Integers:
    """Disks that the pulse drives: those that overlap the left wall, by any amount, within the transmitter's band.

    Both are judged in the reference geometry, at rest, so they are the same in all samples of a packing. None where the
    wall itself is the transmitter. `ValueError` if no disk touches the band.
    """
    if rule.transmitter == "wall":
        return np.zeros(0, dtype=np.int64)
    in_band = np.abs(packing.y - packing.height / 2.0) < rule.transmitter_half_width
    found = np.flatnonzero(in_band & (packing.x < packing.radius))
    cure = "no disk touches the transmitter: make it wider"
    require(len(found) > 0, "transmitter_half_width", rule.transmitter_half_width, cure)
    return found


def _within_reach(packing: Packing, rule: WaveRule) -> Flags:
    """(N,) disks that are not deep in a layer that damps by 1."""
    if rule.boundary_damping < 1.0:
        return np.ones(len(packing.x), dtype=bool)
    middle = packing.height / 2.0
    bands = max(rule.transmitter_half_width, rule.receiver_half_width)
    reach = max(middle - rule.boundary_thickness, bands) + _DEPTH * 2.0 * float(packing.radius.mean())
    return np.asarray(np.abs(packing.y - middle) < reach)
