"""Bundles: the arrays of one sample in the form in which the kernel computes `ABREAST` pairs, or disks, at once.

Pairs are dealt out to bundles in the order of the list, anew for each block of disks (see `layout.Front`), so that the
last bundle of a block may have places left. They are filled with the block's last pair, without stiffness: its forces
are zeros, and zeros change no sum.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.assembly import aligned_copy, aligned_zeros
from calcidem.dem.kernels.features import ABREAST, Features
from calcidem.dem.kernels.layout import ROTATION, XY, Floats, Grains, Integers, Motion, Pairs, System, X
from calcidem.dem.kernels.records import RECORD

_HISTORY_NUMBERS = {"shear": 1, "root": 1, "bond_force": 3}
"""Histories of a pair, and their numbers."""


@dataclass(frozen=True, slots=True)
class Bundles:
    """Which pairs are in which bundle.

    Attributes
    ----------
    start
        (N + 1,) at the first disk of each block, and after the last disk: its first bundle.
    pair
        (B, 8) pairs of the bundles.
    place
        (M,) where each pair is among the places of all bundles, counted through.
    filling
        Bundle and place of those that are filled up.
    """

    start: Integers
    pair: Integers
    place: Integers
    filling: tuple[Integers, ...]


def plan_bundles(pairs: Pairs, block: int, count: int) -> Bundles:
    """Deal the pairs of ``count`` disks out, block by block."""
    border = np.append(np.arange(0, count, block), count)
    first_pair = pairs.start[border]
    needed = -(-np.diff(first_pair) // ABREAST)
    first_bundle = np.concatenate([[0], np.cumsum(needed)])
    block_of_bundle = np.repeat(np.arange(len(needed)), needed)
    begin = first_pair[block_of_bundle] + ABREAST * (np.arange(first_bundle[-1]) - first_bundle[block_of_bundle])
    pair = begin[:, None] + np.arange(ABREAST)
    last = first_pair[block_of_bundle + 1][:, None] - 1
    start = np.zeros(count + 1, dtype=np.int64)
    start[border] = first_bundle
    real = pair <= last
    return Bundles(start, np.minimum(pair, last), np.flatnonzero(real), np.nonzero(~real))


def bundle(system: System, bundles: Bundles, features: Features) -> System:
    """The arrays of one sample in bundles and records; what is no part of pairs and disks is that of the system."""
    grains, motion, watch = system.grains, system.motion, system.watch
    return system._replace(
        grains=_bundle_grains(grains, features),
        motion=Motion(*(_records(array.reshape(-1, 3)) for array in motion)),
        pairs=_bundle_pairs(system.pairs, bundles, grains.radius, features),
        watch=watch._replace(origin=_records(watch.origin[:, :, 0])),
    )


def unbundle(bundled: System, bundles: Bundles, system: System, features: Features) -> None:
    """Bring what the kernel has changed in bundles and records back to a system, in place."""
    moving = slice(X, ROTATION + 1) if features.rotation else XY
    for records, array in zip(bundled.motion, system.motion, strict=True):
        disks = array.reshape(-1, 3)
        disks[:, moving] = records.reshape(-1, RECORD)[: len(disks), moving]
    new, old = bundled.pairs, system.pairs
    for name in _histories(features):
        count, numbers = len(bundles.place), _HISTORY_NUMBERS[name]
        places = getattr(new, name).reshape(len(bundles.pair), numbers, ABREAST).swapaxes(1, 2)
        values = places.reshape(bundles.pair.size, numbers).take(bundles.place, axis=0)
        getattr(old, name).reshape(count, numbers)[...] = values
    if features.breakage:
        bits = new.intact[:, None] >> np.arange(ABREAST, dtype=np.uint32) & np.uint32(1)
        old.intact[...] = bits.reshape(-1)[bundles.place]


def _records(values: Floats) -> Floats:
    """(4 N', 1) records of values (N, 2 or 3), filled up with zeros to a multiple of eight disks."""
    count, width = values.shape
    records = aligned_zeros((count + -count % ABREAST, RECORD), values.dtype)
    records[:count, :width] = values
    return records.reshape(-1, 1)


def _bundle_grains(grains: Grains, features: Features) -> Grains:
    """Disks with the constants of their motion as records: the inverse of mass and inertia in one."""
    inverse = np.column_stack([grains.inverse_mass, grains.inverse_mass, grains.inverse_inertia])
    damping = np.broadcast_to(grains.damping[:, None], inverse.shape)
    return grains._replace(
        inverse_mass=_records(inverse),
        damping=_records(damping) if features.damping else grains.load,
        load=_records(grains.load) if features.loads else grains.load,
    )


def _histories(features: Features) -> list[str]:
    """Histories of pairs that the kernel uses, apart from whether bonds are intact."""
    uses = {
        "shear": not features.linear,
        "root": features.rescaling or features.finite or features.midpoint,
        "bond_force": features.bonds and not features.linear,
    }
    return [name for name, used in uses.items() if used]


def _stiffnesses(features: Features) -> list[str]:
    """Constants that make the forces of a pair."""
    uses = {
        "tangent": features.linear,
        "hertz": not features.linear,
        "mindlin": not features.linear,
        "bond": features.bonds,
        "linear": features.linear_group,
    }
    return [name for name, used in uses.items() if used]


def _bundle_pairs(pairs: Pairs, bundles: Bundles, radius: Floats, features: Features) -> Pairs:
    """Pairs in bundles: (B, 8) for (M,) and (B, K, 8) for (M, K); disks are the rows where their records begin.

    What the kernel does not need is left as it is: dealing out costs what some steps cost.
    """

    def dealt(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        taken = array.take(bundles.pair, axis=0)
        return aligned_copy(taken if taken.ndim == bundles.pair.ndim else taken.swapaxes(1, 2))

    def bits(array: Integers) -> Integers:
        packed: Integers = (array[bundles.pair] << np.arange(ABREAST, dtype=np.uint32)).sum(axis=1, dtype=np.uint32)
        return packed

    constants = ["geometry", *([] if features.linear else ["friction"]), *(["strength"] if features.breakage else [])]
    fields = {name: dealt(getattr(pairs, name)) for name in constants}
    for name in _stiffnesses(features):
        fields[name] = dealt(getattr(pairs, name))
        np.moveaxis(fields[name], -1, 1)[bundles.filling] = 0.0
    for name in _histories(features):
        history = dealt(getattr(pairs, name).reshape(len(pairs.first), _HISTORY_NUMBERS[name]))
        if name != "root":
            history.swapaxes(1, 2)[bundles.filling] = 0.0
        fields[name] = history.reshape(-1, ABREAST)
    ends = np.column_stack([pairs.first, pairs.second])
    return pairs._replace(
        **fields,
        start=bundles.start,
        first=dealt(RECORD * pairs.first),
        second=dealt(RECORD * pairs.second),
        cemented=bits(pairs.cemented) if features.bonds else pairs.cemented,
        intact=bits(pairs.intact) if features.bonds else pairs.intact,
        radii=dealt(radius[ends]) if features.finite else pairs.radii,
    )
