"""Lets a compiled function take `Features` as an argument whose values are known to the compiler.

The values are part of the argument's *type*, so ``if features.slip:`` costs nothing at run time, each
combination is compiled and cached once, and with the JIT off the same code reads the plain dataclass.
"""

# ruff: noqa: ANN401 - values of the compiler (contexts, builders, LLVM values) have no static types
# numba describes only a part of itself:
# mypy: disable-error-code="no-untyped-call, untyped-decorator, override"

from typing import Any

from numba.core import types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

from calcidem.dem.kernels.features import Features


class _FeaturesType(types.Type):
    """Numba type of one combination of features."""

    def __init__(self, values: tuple[tuple[str, int | bool], ...]) -> None:
        self.values = values
        super().__init__(name=f"Features({', '.join(f'{name}={value}' for name, value in values)})")

    @property
    def key(self) -> tuple[tuple[str, int | bool], ...]:
        """What makes two combinations the same."""
        return self.values


@typeof_impl.register(Features)
def _type_of_features(features: Features, context: Any) -> _FeaturesType:
    """Numba type of a `Features` object."""
    del context
    return _FeaturesType(features.items())


@register_model(_FeaturesType)
class _FeaturesModel(models.OpaqueModel):
    """Nothing is passed at run time."""


@unbox(_FeaturesType)
def _unbox_features(kind: _FeaturesType, features: Any, context: Any) -> Any:
    """Pass no data: the type says it all."""
    del kind, features
    return NativeValue(context.context.get_dummy_value())


@infer_getattr
class _FeaturesAttributes(AttributeTemplate):
    """Type of ``features.name``: the literal value itself."""

    key = _FeaturesType

    def generic_resolve(self, kind: _FeaturesType, name: str) -> Any:
        """Literal type of a switch, None for an unknown name."""
        values = dict(kind.values)
        return types.literal(values[name]) if name in values else None


@lower_getattr_generic(_FeaturesType)
def _lower_feature(context: Any, builder: Any, kind: _FeaturesType, value: Any, name: str) -> Any:
    """Machine code of ``features.name``: a constant."""
    del value
    literal = types.literal(dict(kind.values)[name])
    return context.get_constant_generic(builder, literal, literal.literal_value)
