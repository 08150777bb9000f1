"""Teaches numba-cuda what `compiling` and `vectors` teach numba: features, and lane vectors of one sample.

Types, operators and intrinsics of lane vectors are numba's, which numba-cuda shares. It has registries of its own for
the types of constants and for rewrites. NVVM lacks some LLVM functions of vectors, and must not contract products.
"""

# ruff: noqa: ANN401 - values of the compiler (contexts, builders, LLVM values) have no static types
# mypy: disable-error-code="no-untyped-call, untyped-decorator, misc"

import re
from typing import Any

from numba.cuda.core import config, ir
from numba.cuda.core.imputils import lower_constant
from numba.cuda.core.rewrites.registry import Rewrite, register_rewrite
from numba.cuda.cudadrv import nvvm
from numba.cuda.typing.typeof import typeof_impl

from calcidem.dem.kernels import compiling
from calcidem.dem.kernels.layout import Features

config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # a batch has a block for each of its samples, at most 32

typeof_impl.register(Features)(compiling.type_of_features)


@lower_constant(compiling.FeaturesType)
def _constant_features(context: Any, builder: Any, kind: Any, features: Any) -> Any:
    """Pass no data: the type has all values."""
    del builder, kind, features
    return context.get_dummy_value()


@register_rewrite("before-inference")
class _KnownFeatures(compiling.KnownFeatures, Rewrite):
    """The same rewrite of numba-cuda's intermediate representation."""

    representation = ir


_BODIES = {
    "sqrt": "%c = call {T} @llvm.nvvm.sqrt.rn.{letter}({T} %x)",
    "fabs": "%i = bitcast {T} %x to {I}\n%j = and {I} %i, {rest}\n%c = bitcast {I} %j to {T}",
    "copysign": "%i = bitcast {T} %x to {I}\n%j = and {I} %i, {rest}\n%y = extractelement <1 x {T}> %b, i32 0\n"
    "%k = bitcast {T} %y to {I}\n%l = and {I} %k, {sign}\n%m = or {I} %j, %l\n%c = bitcast {I} %m to {T}",
}
"""What LLVM functions of vectors do with the lane %x of their first argument, in the instructions that NVVM knows."""


def _define(declaration: re.Match[str]) -> str:
    """Definition of a function of lane vectors, in place of its declaration."""
    name, bits = declaration[1], int(declaration[2])
    number, letter = {32: ("float", "f"), 64: ("double", "d")}[bits]
    rest = 2 ** (bits - 1) - 1
    body = _BODIES[name].format(T=number, I=f"i{bits}", letter=letter, rest=rest, sign=-rest - 1)
    second = f", <1 x {number}> %b" if name == "copysign" else ""
    declared = f"declare {number} @llvm.nvvm.sqrt.rn.{letter}({number})\n" if name == "sqrt" else ""
    return (
        f'{declared}define linkonce_odr <1 x {number}> @"lane_{name}_{bits}"'
        f"(<1 x {number}> %a{second}) alwaysinline {{\n%x = extractelement <1 x {number}> %a, i32 0\n{body}\n"
        f"%r = insertelement <1 x {number}> undef, {number} %c, i32 0\nret <1 x {number}> %r\n}}\n"
    )


def _translate(module: str) -> str:
    """Write a module in the dialect of NVVM, which has neither `fneg` nor these functions of vectors."""
    module = re.sub(r'declare [^@\n]+ @"llvm\.(sqrt|fabs|copysign)\.v1f(32|64)"\(.*\)', _define, module)
    module = re.sub(r'"llvm\.(sqrt|fabs|copysign)\.v1f', r'"lane_\1_', module)
    return re.sub(r"fneg (<1 x (float|double)>)", r"fsub \1 <\2 -0.0>,", module)


_compile_ir = nvvm.compile_ir


def _compile_exactly(modules: str | list[str], **options: Any) -> Any:
    """Compile without multiply-adds, estimates and flushing of denormals; numba-cuda has no option for the first."""
    translated = [_translate(module) for module in ([modules] if isinstance(modules, str) else modules)]
    return _compile_ir(translated, **options, fma=False, ftz=False, prec_div=True, prec_sqrt=True)


nvvm.compile_ir = _compile_exactly
