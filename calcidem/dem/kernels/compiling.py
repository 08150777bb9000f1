"""How the functions of the kernel are compiled."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

from llvmlite import binding
from numba import njit
from numba.core import codegen, config, event

Function = TypeVar("Function", bound=Callable[..., Any])


_COMPILING = event.TimingListener()  # type: ignore[no-untyped-call]  # numba describes only a part of itself
event.register("numba:compiler_lock", _COMPILING)  # type: ignore[no-untyped-call]  # held while loading from the cache, too


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


def compile_function(**options: Any) -> Callable[[Function], Function]:  # noqa: ANN401 - options of numba, of many types
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


def target_processor() -> tuple[str, tuple[str, ...]]:
    """LLVM's names of the processor and features for which kernels are compiled, with numba's settings."""
    name, features = (getattr(config, setting) for setting in ("CPU_NAME", "CPU_FEATURES"))
    if features is None:
        features = codegen.get_host_cpu_features()  # type: ignore[no-untyped-call]
    known = tuple(part[1:] for part in features.split(",") if part.startswith("+"))
    return name or binding.get_host_cpu_name(), known
