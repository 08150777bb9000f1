"""Records: x, y and rotation of a disk of one sample and a fourth number, adjacent in memory.

A kernel for one sample computes eight pairs or moves eight disks at once. A record is loaded as a whole. Eight records
are then transposed in registers to vectors of eight x, eight y and eight rotations, and back.

As in `lanes` the Python bodies define the meaning; the intrinsics below them are the machine code.
"""

# ruff: noqa: ANN401 - values of the compiler (contexts, builders, LLVM values) have no static types
# mypy: disable-error-code="no-untyped-call, untyped-decorator, attr-defined, call-arg"
# numba and llvmlite describe only a part of themselves; intrinsics are called without the first argument they name.

from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from calcidem.dem.kernels.lanes import Vector
from calcidem.dem.kernels.layout import ABREAST
from calcidem.dem.kernels.vectors import LaneType, compile_as

RECORD = 4
"""Numbers in a record."""


def load_run(array: Vector, begin: Vector, width: int) -> Vector:
    """Vector of ``width`` consecutive entries of an array (R, 1)."""
    return array[begin : begin + width, 0].copy()


def store_run(array: Vector, begin: Vector, value: Vector) -> None:
    """Write a vector into consecutive entries of an array (R, 1)."""
    array[begin : begin + len(value), 0] = value


def gather_records(array: Vector, table: Vector, index: tuple[Vector, ...]) -> tuple[Vector, Vector, Vector]:
    """Vectors of x, y and rotation of the records that begin at the entries ``table[index]`` of an array (R, 1)."""
    records = array[table[index][:, None] + np.arange(RECORD), 0]
    return records[:, 0], records[:, 1], records[:, 2]


def records_to_columns(a: Vector, b: Vector, c: Vector, d: Vector) -> tuple[Vector, Vector, Vector]:
    """Vectors of x, y and rotation of the eight records in four vectors."""
    records = np.concatenate([a, b, c, d]).reshape(ABREAST, RECORD)
    return records[:, 0], records[:, 1], records[:, 2]


def columns_to_records(x: Vector, y: Vector, rotation: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """Four vectors of eight records; the fourth number is the rotation again."""
    a, b, c, d = np.column_stack([x, y, rotation, rotation]).reshape(RECORD, -1)
    return a, b, c, d


def _shuffle(builder: Any, first: Any, second: Any, places: Sequence[int]) -> Any:
    """Vector of entries of two vectors; places of the second follow those of the first."""
    kind = ir.VectorType(ir.IntType(32), len(places))
    return builder.shuffle_vector(first, second, ir.Constant(kind, list(places)))


def _vector_at(context: Any, builder: Any, array_type: Any, array: Any, begin: Any, vector: Any) -> Any:
    """Pointer to a vector that begins at an entry of an array (R, 1)."""
    data = make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [begin]), vector.as_pointer())


@intrinsic(prefer_literal=True)
def _load_run(typingctx: Any, array: Any, begin: Any, width: Any) -> Any:
    """Compiled side of `load_run`."""
    del typingctx, begin
    lane = LaneType(array.dtype, width.literal_value)

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        pointer = _vector_at(context, builder, sig.args[0], args[0], args[1], context.get_value_type(lane))
        return builder.load(pointer, align=array.dtype.bitwidth // 8)

    return lane(array, types.intp, width), codegen


@intrinsic
def _store_run(typingctx: Any, array: Any, begin: Any, value: Any) -> Any:
    """Compiled side of `store_run`."""
    del typingctx, begin

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        pointer = _vector_at(context, builder, sig.args[0], args[0], args[1], args[2].type)
        builder.store(args[2], pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


def _compile_columns(context: Any, builder: Any, result: Any, records: Sequence[Any]) -> Any:
    """Compiled tuple of x, y and rotation of four vectors of two records each."""
    half = 2 * RECORD
    vectors = []
    for component in range(len(result)):
        places = [component, RECORD + component, half + component, half + RECORD + component]
        halves = [_shuffle(builder, *records[at : at + 2], places) for at in (0, 2)]
        vectors.append(_shuffle(builder, *halves, range(ABREAST)))
    return context.make_tuple(builder, result, vectors)


@intrinsic
def _gather_records(typingctx: Any, array: Any, table: Any, index: Any) -> Any:
    """Compiled side of `gather_records`."""
    del typingctx, index
    result = types.UniTuple(LaneType(array.dtype, ABREAST), 3)

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        (row,) = cgutils.unpack_tuple(builder, args[2])
        rows = make_array(sig.args[1])(context, builder, args[1]).data
        vector = ir.VectorType(context.get_value_type(array.dtype), RECORD)
        single = []
        for lane in range(ABREAST):
            place = builder.add(builder.mul(row, row.type(ABREAST)), row.type(lane))
            begin = builder.sext(builder.load(builder.gep(rows, [place])), ir.IntType(64))
            pointer = _vector_at(context, builder, sig.args[0], args[0], begin, vector)
            single.append(builder.load(pointer, align=array.dtype.bitwidth // 8))
        both = [_shuffle(builder, *single[at : at + 2], range(2 * RECORD)) for at in range(0, ABREAST, 2)]
        return _compile_columns(context, builder, result, both)

    return result(array, table, types.UniTuple(types.intp, 1)), codegen


@intrinsic
def _records_to_columns(typingctx: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Compiled side of `records_to_columns`."""
    del typingctx
    result = types.UniTuple(a, 3)

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del sig
        return _compile_columns(context, builder, result, args)

    return result(a, b, c, d), codegen


@intrinsic
def _columns_to_records(typingctx: Any, x: Any, y: Any, rotation: Any) -> Any:
    """Compiled side of `columns_to_records`."""
    del typingctx
    result = types.UniTuple(x, 4)

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del sig
        records = []
        for one in range(0, ABREAST, 2):
            other = one + 1
            places = [one, ABREAST + one, one, one, other, ABREAST + other, other, other]
            flat = _shuffle(builder, args[0], args[1], places)
            turn, turn_too = ABREAST + one, ABREAST + other
            records.append(_shuffle(builder, flat, args[2], [0, 1, turn, turn, 4, 5, turn_too, turn_too]))
        return context.make_tuple(builder, result, records)

    return result(x, y, rotation), codegen


for _function, _instruction in (
    (load_run, _load_run),
    (store_run, _store_run),
    (gather_records, _gather_records),
    (records_to_columns, _records_to_columns),
    (columns_to_records, _columns_to_records),
):
    compile_as(_function, _instruction)
