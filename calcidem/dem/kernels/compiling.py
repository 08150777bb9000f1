"""How the functions of the kernel are compiled, and how the compiler knows the values of an argument `Features`.

The values are part of the argument's *type*. They replace ``features.slip`` before types are inferred, so a branch that
is off is dropped before it is compiled. Each combination is compiled and cached once. Without the JIT the same code
reads the plain dataclass.
"""

# ruff: noqa: ANN401 - options and values of the compiler (contexts, builders, LLVM values) have no static types
# numba describes only a part of itself:
# mypy: disable-error-code="no-untyped-call, untyped-decorator, override"

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from numba import njit
from numba.core import event, ir, types
from numba.core.rewrites.registry import Rewrite, register_rewrite
from numba.extending import NativeValue, models, register_model, typeof_impl, unbox

from calcidem.dem.kernels.layout import Features

Function = TypeVar("Function", bound=Callable[..., Any])


_COMPILING = event.TimingListener()
event.register("numba:compiler_lock", _COMPILING)  # held while loading from the cache, too


def seconds_compiling() -> float:
    """Seconds that this process has spent on compiling functions, or on loading them from the cache on disk."""
    return float(_COMPILING.duration) if _COMPILING.done else 0.0


class _FunctionListener(event.Listener):
    """Counts functions as they are compiled; those loaded from the cache do not count."""

    def __init__(self, tell: Callable[[str, int], object]) -> None:
        self._tell, self._done = tell, 0

    def on_start(self, event: event.Event) -> None:
        self._tell(event.data["dispatcher"].py_func.__name__, self._done)

    def on_end(self, event: event.Event) -> None:
        del event
        self._done += 1


@contextmanager
def watch_compiling(tell: Callable[[str, int], object]) -> Iterator[None]:
    """Within this context, tell the name of each function whose compilation begins, and the number of finished ones."""
    with event.install_listener("numba:compile", _FunctionListener(tell)):
        yield


SOURCES = sha256(b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))).hexdigest()
"""Identity of the kernel's source code."""


def compile_function(**options: Any) -> Callable[[Function], Function]:
    """Return numba's ``njit``, without the counting of references to arrays.

    The kernel does not allocate or keep arrays, so the counts are not needed. Numba removes them itself, except around
    branches that depend on data. There, counting for each pair would cost several times as much as the physics.

    With ``cache`` the names of the files on disk contain the identity of the sources. Numba alone compares only the
    file of the outermost function: an edited contact law would run with old machine code. It also fails if cached
    files of another calcidem contain classes that no longer exist.
    """

    def decorate(function: Function) -> Function:
        if options.get("cache"):
            function.__qualname__ += f"_{SOURCES[:16]}"
        compiled: Function = njit(_nrt=False, **options)(function)  # type: ignore[call-overload]
        return compiled

    return decorate


# Only compiled code calls these. Entries for Python are omitted, since making them took a third of the compile time.
inline = compile_function(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)


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
