"""Machine code of lane vectors: numba types, arithmetic and instructions. Kernels use them through `lanes`.

Every operation is one of IEEE 754, rounded once: no contraction (multiply-add), no re-association, no estimates, no
flushing of denormal numbers, nothing that depends on the processor. All processors give the same bits.
"""

# ruff: noqa: ANN401 - values of the compiler (contexts, builders, LLVM values) have no static types
# numba and llvmlite describe only a part of themselves; intrinsics are called without the first argument they name.
# mypy: disable-error-code="no-untyped-call, untyped-decorator, attr-defined, assignment, misc, call-arg"
# mypy: disable-error-code="var-annotated, unreachable"

import operator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing import signature
from numba.core.typing.templates import AbstractTemplate, infer_global, make_intrinsic_template
from numba.extending import intrinsic, models, register_model
from numba.np.arrayobj import make_array


class LaneType(types.Type):
    """Numba type of ``width`` floating-point numbers in one vector."""

    def __init__(self, dtype: Any, width: int) -> None:
        self.dtype = dtype
        self.width = width
        super().__init__(name=f"Lane({dtype}, {width})")

    @property
    def key(self) -> tuple[Any, int]:
        """Identity of a lane type."""
        return self.dtype, self.width

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        """Allow a number where a lane vector is expected; it is spread over all lanes."""
        del typingctx
        return Conversion.safe if isinstance(other, types.Number) else None


class _MaskType(types.Type):
    """Numba type of one truth value for each lane."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(name=f"Mask({width})")

    @property
    def key(self) -> int:
        """Identity of a mask type."""
        return self.width


@register_model(LaneType)
class _LaneModel(models.PrimitiveModel):
    """A lane vector is an LLVM vector of floats."""

    def __init__(self, manager: Any, lane: LaneType) -> None:
        element = manager.lookup(lane.dtype).get_value_type()
        super().__init__(manager, lane, ir.VectorType(element, lane.width))


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    """A mask is an LLVM vector of bits, which AVX-512 keeps in a mask register."""

    def __init__(self, manager: Any, mask: _MaskType) -> None:
        super().__init__(manager, mask, ir.VectorType(ir.IntType(1), mask.width))


def _splat(builder: Any, scalar: Any, width: int) -> Any:
    """Spread one LLVM scalar over ``width`` lanes."""
    single = builder.insert_element(
        ir.Constant(ir.VectorType(scalar.type, width), ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
    )
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return builder.shuffle_vector(single, single, zeros)


@lower_cast(types.Number, LaneType)
def _cast_number_to_lane(context: Any, builder: Any, from_type: Any, to_type: LaneType, value: Any) -> Any:
    """Spread a number over the lanes, in the precision of the lanes."""
    return _splat(builder, context.cast(builder, value, from_type, to_type.dtype), to_type.width)


def _widest_lane(args: tuple[Any, ...]) -> LaneType | None:
    """Lane type among the arguments, if one of them is a lane vector and the others fit it."""
    lanes = [arg for arg in args if isinstance(arg, LaneType)]
    if not lanes or not all(arg == lanes[0] or isinstance(arg, types.Number) for arg in args):
        return None
    return lanes[0]


def _register_arithmetic(function: Any, instruction: str) -> None:
    """Teach numba one arithmetic operator on lane vectors."""

    @infer_global(function)
    class Arithmetic(AbstractTemplate):
        def generic(self, args: tuple[Any, ...], kws: Any) -> Any:
            del kws
            lane = _widest_lane(args)
            return None if lane is None else signature(lane, *[lane] * len(args))

    @lower_builtin(function, *[LaneType] * (1 if instruction == "fneg" else 2))
    def lower(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del context, sig
        return getattr(builder, instruction)(*args)


def _register_comparison(function: Any, symbol: str) -> None:
    """Teach numba one comparison of lane vectors; comparisons with NaN are false."""

    @infer_global(function)
    class Comparison(AbstractTemplate):
        def generic(self, args: tuple[Any, ...], kws: Any) -> Any:
            del kws
            lane = _widest_lane(args)
            return None if lane is None else signature(_MaskType(lane.width), lane, lane)

    @lower_builtin(function, LaneType, LaneType)
    def lower(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del context, sig
        return builder.fcmp_ordered(symbol, *args)


def _register_logic(function: Any, instruction: str) -> None:
    """Teach numba one logical operator on masks."""

    @infer_global(function)
    class Logic(AbstractTemplate):
        def generic(self, args: tuple[Any, ...], kws: Any) -> Any:
            del kws
            if all(isinstance(arg, _MaskType) for arg in args):
                return signature(args[0], *args)
            return None

    @lower_builtin(function, *[_MaskType] * (1 if instruction == "not_" else 2))
    def lower(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del context, sig
        return getattr(builder, instruction)(*args)


for _function, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
    (operator.neg, "fneg"),
):
    _register_arithmetic(_function, _instruction)
for _function, _symbol in (
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.ne, "!="),
):
    _register_comparison(_function, _symbol)
for _function, _instruction in ((operator.and_, "and_"), (operator.or_, "or_"), (operator.invert, "not_")):
    _register_logic(_function, _instruction)


def compile_as(function: Any, instruction: Any) -> None:
    """Make compiled code use an intrinsic for a Python function.

    An overload would do so, too, but compiles a function for every combination of types: most of those of a kernel.
    """
    template = make_intrinsic_template(function, instruction.__wrapped__, function.__name__, prefer_literal=True)
    infer_global(function, types.Function(template))


def _integers(context: Any, builder: Any, index_type: Any, index: Any) -> list[Any]:
    """Entries of a compiled index tuple as machine integers; none is negative, so none needs wrapping around."""
    values = zip(cgutils.unpack_tuple(builder, index), index_type, strict=True)
    return [context.cast(builder, value, kind, types.intp) for value, kind in values]


def _row_pointer(
    context: Any, builder: Any, array_type: Any, array: Any, index_type: Any, index: Any, vector: Any
) -> Any:
    """Pointer to row ``index``, an LLVM vector, of a C-contiguous array whose last axis is the lane.

    The length of that axis is known to the compiler, so the address needs a shift instead of products with strides.
    """
    view = make_array(array_type)(context, builder, array)
    shape = cgutils.unpack_tuple(builder, view.shape)
    row, *others = _integers(context, builder, index_type, index)
    for value, length in zip(others, shape[1:-1], strict=True):
        row = builder.add(builder.mul(row, length), value)
    return builder.gep(builder.bitcast(view.data, vector.as_pointer()), [row])


@intrinsic(prefer_literal=True)
def load_vector(typingctx: Any, array: Any, index: Any, width: Any) -> Any:
    """Compiled side of `load`."""
    del typingctx
    lane = LaneType(array.dtype, width.literal_value)

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        vector = context.get_value_type(lane)
        pointer = _row_pointer(context, builder, sig.args[0], args[0], sig.args[1], args[1], vector)
        return builder.load(pointer, align=array.dtype.bitwidth // 8)

    return lane(array, index, width), codegen


@intrinsic
def store_vector(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    """Compiled side of `store`."""
    del typingctx

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        pointer = _row_pointer(context, builder, sig.args[0], args[0], sig.args[1], args[1], args[2].type)
        builder.store(args[2], pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, index, value), codegen


@intrinsic
def load_scalar(typingctx: Any, array: Any, index: Any) -> Any:
    """Compiled side of `scalar`."""
    del typingctx

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        view = make_array(sig.args[0])(context, builder, args[0])
        place = _integers(context, builder, sig.args[1], args[1])
        return builder.load(cgutils.get_item_pointer(context, builder, sig.args[0], view, place))

    return array.dtype(array, index), codegen


@intrinsic(prefer_literal=True)
def fill_with_scalar(typingctx: Any, number: Any, width: Any) -> Any:
    """Compiled side of `fill_lanes`."""
    del typingctx
    if isinstance(number, LaneType):
        return number(number, width), lambda *generation: generation[-1][0]
    lane = LaneType(number, width.literal_value)

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del context, sig
        return _splat(builder, args[0], lane.width)

    return lane(number, width), codegen


@intrinsic
def zero_vector(typingctx: Any, value: Any) -> Any:
    """Compiled side of `zero_like`."""
    del typingctx

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del context, builder, sig
        return ir.Constant(args[0].type, None)

    return value(value), codegen


@intrinsic(prefer_literal=True)
def bits_to_mask(typingctx: Any, bits: Any, width: Any) -> Any:
    """Compiled side of `mask_of_bits`."""
    del typingctx
    mask = _MaskType(width.literal_value)

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del context, sig
        narrow = args[0]
        if narrow.type.width > mask.width:
            narrow = builder.trunc(narrow, ir.IntType(mask.width))
        return builder.bitcast(narrow, ir.VectorType(ir.IntType(1), mask.width))

    return mask(bits, width), codegen


@intrinsic
def mask_to_bits(typingctx: Any, mask: Any) -> Any:
    """Compiled side of `bits_of_mask`."""
    del typingctx

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del context, sig
        narrow = builder.bitcast(args[0], ir.IntType(mask.width))
        return builder.zext(narrow, ir.IntType(64)) if mask.width < 64 else narrow  # bits of uint64

    return types.uint64(mask), codegen


@intrinsic
def select_lanes(typingctx: Any, mask: Any, if_true: Any, if_false: Any) -> Any:
    """Compiled side of `select`."""
    del typingctx
    lane = _widest_lane((if_true, if_false))

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        values = [context.cast(builder, value, kind, lane) for value, kind in zip(args[1:], sig.args[1:], strict=True)]
        return builder.select(args[0], *values)

    return lane(mask, if_true, if_false), codegen


def unary_intrinsic(name: str) -> Any:
    """Make an intrinsic of one LLVM vector function such as ``llvm.sqrt``."""

    @intrinsic
    def call(typingctx: Any, value: Any) -> Any:
        del typingctx

        def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
            del context, sig
            return _call_vector_function(builder, name, value, args)

        return value(value), codegen

    return call


@intrinsic
def copy_sign(typingctx: Any, value: Any, sign: Any) -> Any:
    """Compiled side of `with_sign`."""
    del typingctx

    def codegen(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        del context, sig
        return _call_vector_function(builder, "llvm.copysign", value, args)

    return value(value, sign), codegen


def _call_vector_function(builder: Any, name: str, lane: LaneType, args: tuple[Any, ...]) -> Any:
    """Call the form of an LLVM function that takes and returns lane vectors."""
    vector = args[0].type
    # llvmlite names intrinsics of scalars only, so the name of the vector form is spelt out.
    mangled = f"{name}.v{lane.width}f{lane.dtype.bitwidth}"
    kind = ir.FunctionType(vector, [vector] * len(args))
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, mangled), args)


sqrt_vector = unary_intrinsic("llvm.sqrt")
absolute_vector = unary_intrinsic("llvm.fabs")
