"""Bundles: arrays of one sample, laid out so that the kernel computes `ABREAST` pairs or disks at once.

Pairs fill bundles in list order, separately for each block of disks (see `layout.Front`). Spare places in a block's
last bundle repeat its last pair with zero stiffness. Its forces are zero and change no sum.
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
"""Histories of a pair, and the count of values in each."""


@dataclass(frozen=True, slots=True)
class _Bundles:
    """Assignment of pairs to bundles."""

    start: Integers
    """(N + 1,) first bundle of a block, stored at the block's first disk; the last entry closes the list."""
    pair: Integers
    """(B, 8) pairs in each bundle."""
    place: Integers
    """(M,) place of each pair, counted through all bundles."""
    filling: tuple[Integers, ...]
    """Bundle and place of each spare place."""


def plan_bundles(pairs: Pairs, block: int, count: int) -> _Bundles:
    """Assign the pairs of ``count`` disks to bundles, block by block."""
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
    return _Bundles(start, np.minimum(pair, last), np.flatnonzero(real), np.nonzero(~real))


def bundle(system: System, bundles: _Bundles, features: Features) -> System:
    """Arrays of one sample as bundles and records; all other arrays are shared with the system."""
    grains, motion, watch = system.grains, system.motion, system.watch
    return system._replace(
        grains=_bundle_grains(grains, features),
        motion=Motion(*(_records(array.reshape(-1, 3)) for array in motion)),
        pairs=_bundle_pairs(system.pairs, bundles, grains.radius, features),
        watch=watch._replace(origin=_records(watch.origin[:, :, 0])),
    )


def unbundle(bundled: System, bundles: _Bundles, system: System, features: Features) -> None:
    """Copy the kernel's changes in bundles and records back to the system, in place."""
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
    """(4 N', 1) records of values (N, 2 or 3), padded with zeros to a multiple of eight disks."""
    count, width = values.shape
    records = aligned_zeros((count + -count % ABREAST, RECORD), values.dtype)
    records[:count, :width] = values
    return records.reshape(-1, 1)


def _bundle_grains(grains: Grains, features: Features) -> Grains:
    """Disks with their constants of motion as records: inverse mass and inertia in one array."""
    inverse = np.column_stack([grains.inverse_mass, grains.inverse_mass, grains.inverse_inertia])
    damping = np.broadcast_to(grains.damping[:, None], inverse.shape)
    return grains._replace(
        inverse_mass=_records(inverse),
        damping=_records(damping) if features.damping else grains.load,
        load=_records(grains.load) if features.loads else grains.load,
    )


def _histories(features: Features) -> list[str]:
    """Histories of pairs that the kernel uses, except the state of bonds."""
    uses = {
        "shear": not features.linear,
        "root": features.rescaling or features.finite or features.midpoint,
        "bond_force": features.bonds and not features.linear,
    }
    return [name for name, used in uses.items() if used]


def _stiffnesses(features: Features) -> list[str]:
    """Constants that determine the forces of a pair."""
    uses = {
        "tangent": features.linear,
        "hertz": not features.linear,
        "mindlin": not features.linear,
        "bond": features.bonds,
        "linear": features.linear_group,
    }
    return [name for name, used in uses.items() if used]


def _bundle_pairs(pairs: Pairs, bundles: _Bundles, radius: Floats, features: Features) -> Pairs:
    """Pairs in bundles: (B, 8) for (M,) and (B, K, 8) for (M, K); disks become the first row of their records.

    Arrays that the kernel does not need stay unchanged, because bundling costs as much as several steps.
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
