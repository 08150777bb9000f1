"""Makes the values of an argument `Features` known to the compiler.

The values are part of the argument's *type*. They replace ``features.slip`` before types are inferred, so a branch that
is off is dropped before it is compiled. Each combination is compiled and cached once. Without the JIT the same code
reads the plain dataclass.
"""

# ruff: noqa: ANN401 - values of the compiler (contexts, builders, LLVM values) have no static types
# numba describes only a part of itself:
# mypy: disable-error-code="no-untyped-call, untyped-decorator, override"

from types import ModuleType
from typing import Any

from numba.core import ir, types
from numba.core.rewrites.registry import Rewrite, register_rewrite
from numba.extending import NativeValue, models, register_model, typeof_impl, unbox

from calcidem.dem.kernels.features import Features


class FeaturesType(types.Type):
    """Numba type of one combination of features."""

    def __init__(self, values: tuple[tuple[str, int | bool], ...]) -> None:
        self.values = values
        super().__init__(name=f"Features({', '.join(f'{name}={value}' for name, value in values)})")

    @property
    def key(self) -> tuple[tuple[str, int | bool], ...]:
        """Identity of a combination."""
        return self.values


@typeof_impl.register(Features)
def type_of_features(features: Features, context: Any) -> FeaturesType:
    """Numba type of a `Features` object."""
    del context
    return FeaturesType(features.items())


@register_model(FeaturesType)
class _FeaturesModel(models.OpaqueModel):
    """No data are passed at run time."""


@unbox(FeaturesType)
def _unbox_features(kind: FeaturesType, features: Any, context: Any) -> Any:
    """Pass no data: the type has all values."""
    del kind, features
    return NativeValue(context.context.get_dummy_value())


@register_rewrite("before-inference")
class KnownFeatures(Rewrite):
    """Replaces ``features.name`` by the value of the switch."""

    representation: ModuleType = ir
    """Module of the compiler's intermediate representation."""

    def __init__(self, state: Any) -> None:
        self._kinds = state.args

    def match(self, func_ir: Any, block: Any, typemap: Any, calltypes: Any) -> bool:
        """Whether a block reads a switch of one of the function's arguments."""
        del typemap, calltypes
        ir = self.representation
        self._definitions, self._block, self._values = func_ir._definitions, block, {}  # noqa: SLF001 - numba has no other
        for read in block.find_exprs("getattr"):
            (owner, *others) = self._definitions[read.value.name]
            if not others and isinstance(owner, ir.Arg) and isinstance(self._kinds[owner.index], FeaturesType):
                self._values[read] = ir.Const(dict(self._kinds[owner.index].values)[read.attr], read.loc)
        return bool(self._values)

    def apply(self) -> Any:
        """The block with the values."""
        for statement in self._block.find_insts(self.representation.Assign):
            if constant := self._values.get(statement.value):
                statement.value = constant
                self._definitions[statement.target.name] = [constant]
        return self._block
