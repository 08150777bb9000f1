"""Lane vectors: one value for each of several samples, held in one vector register.

All cells of a batch share one packing, so the kernel advances them side by side: lane ``l`` of every
value belongs to cell ``l``. A kernel written with the functions of this module reads like scalar
physics. Without the JIT a lane vector is a NumPy array of length ``width``. Compiled, it is an LLVM
vector ``<width x double>``, so the machine code is vector code without an auto-vectoriser.

Augmented assignment (``+=``) is not defined on purpose: NumPy would change the array under all its
names, a vector register would not, and both must mean the same.

Every operation is one of IEEE 754, in the written order. The bits of a lane do not depend on the values or the number
of other lanes, or on the processor.
"""

# ruff: noqa: ARG005 - numba wants two levels: the outer function sees types, the inner one is compiled
# mypy: disable-error-code="call-arg, no-untyped-call"
# Intrinsics are called without the first argument they name.

from typing import Any, TypeAlias

import numpy as np
from numba.core import types
from numba.extending import overload

from calcidem.dem.kernels.compiling import inline
from calcidem.dem.kernels.vectors import (
    absolute_vector,
    bits_to_mask,
    compile_as,
    copy_sign,
    fill_with_scalar,
    load_scalar,
    load_vector,
    mask_to_bits,
    select_lanes,
    sqrt_vector,
    store_vector,
    zero_vector,
)

Vector: TypeAlias = Any
"""A lane vector, its mask, or a number that stands for all lanes: Python has no one type for the three."""

_DUST = 1.0e-30


def load(array: Vector, index: tuple[Vector, ...], width: int) -> Vector:
    """Lane vector in row ``index`` of an array whose last axis is the lane."""
    del width
    return array[index].copy()


def store(array: Vector, index: tuple[Vector, ...], value: Vector) -> None:
    """Write a lane vector into row ``index`` of an array whose last axis is the lane."""
    array[index] = value


def scalar(array: Vector, index: tuple[Vector, ...]) -> Vector:
    """One entry of an array that all lanes share; no index may be negative."""
    return array[index]


def fill_lanes(value: Vector, width: int) -> Vector:
    """Lane vector with ``value`` in every lane; a lane vector is returned unchanged."""
    return np.full(width, value)


def zero_like(value: Vector) -> Vector:
    """Zero in every lane, of the type of ``value``."""
    return np.zeros_like(value)


def mask_of_bits(bits: Vector, width: int) -> Vector:
    """Mask whose lane ``l`` is bit ``l`` of an unsigned integer."""
    return (np.uint64(bits) >> np.arange(width, dtype=np.uint64)) & np.uint64(1) == 1


def bits_of_mask(mask: Vector) -> Vector:
    """Unsigned integer whose bit ``l`` is lane ``l`` of the mask."""
    return np.uint64(sum(1 << lane for lane, truth in enumerate(mask) if truth))


def select(mask: Vector, if_true: Vector, if_false: Vector) -> Vector:
    """``if_true`` in the lanes where the mask holds, ``if_false`` in the others."""
    return np.where(mask, if_true, if_false)


def square_root(value: Vector) -> Vector:
    """Square root lane by lane; NaN, without a warning, where the value is negative."""
    with np.errstate(invalid="ignore"):
        return np.sqrt(value)


def magnitude(value: Vector) -> Vector:
    """Absolute value lane by lane."""
    return np.abs(value)


def with_sign(value: Vector, sign: Vector) -> Vector:
    """Absolute value of the first with the sign of the second, lane by lane."""
    return np.copysign(value, sign)


def without_dust(value: Vector) -> Vector:
    """Replace single-precision numbers below 1e-30 by zero; double precision is not changed.

    Amplitudes decay without limit ahead of a wave front, and an operation on a denormal number costs as much as a
    hundred others. Doubles leave that range within a few steps. Processors can flush such numbers to zero, but not
    all at the same threshold.
    """
    return np.where(np.abs(value) < _DUST, np.float32(0.0), value) if value.dtype == np.float32 else value


def larger(a: Vector, b: Vector) -> Vector:
    """Larger of two values lane by lane (the second where they compare false, as with NaN)."""
    return np.where(a > b, a, b)


def smaller(a: Vector, b: Vector) -> Vector:
    """Smaller of two values lane by lane (the second where they compare false, as with NaN)."""
    return np.where(a < b, a, b)


@inline
def row(item: Vector, component: Vector) -> Vector:
    """Row of one of the three components of an item (x, y, rotation of a disk) in an array of shape (3 items, L)."""
    return 3 * item + component


# The Python bodies above are the meaning, intrinsics the machine code.
for _function, _instruction in (
    (load, load_vector),
    (store, store_vector),
    (scalar, load_scalar),
    (fill_lanes, fill_with_scalar),
    (zero_like, zero_vector),
    (mask_of_bits, bits_to_mask),
    (bits_of_mask, mask_to_bits),
    (select, select_lanes),
    (square_root, sqrt_vector),
    (magnitude, absolute_vector),
    (with_sign, copy_sign),
):
    compile_as(_function, _instruction)
overload(without_dust)(
    lambda value: (
        (lambda value: select_lanes(absolute_vector(value) < _DUST, 0.0, value))
        if value.dtype == types.float32
        else (lambda value: value)
    )
)
overload(larger)(lambda a, b: lambda a, b: select_lanes(a > b, a, b))
overload(smaller)(lambda a, b: lambda a, b: select_lanes(a < b, a, b))
