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
    """Hears of each function as it begins to be compiled; of those that are taken from the cache it does not."""

    def __init__(self, tell: Callable[[str, int], object]) -> None:
        self._tell, self._done = tell, 0

    def on_start(self, event: event.Event) -> None:
        self._tell(event.data["dispatcher"].py_func.__name__, self._done)

    def on_end(self, event: event.Event) -> None:
        del event
        self._done += 1


@contextmanager
def watch_compiling(tell: Callable[[str, int], object]) -> Iterator[None]:
    """Tell the name of each function that begins to be compiled meanwhile, and how many are finished."""
    with event.install_listener("numba:compile", _FunctionListener(tell)):
        yield


SOURCES = sha256(b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))).hexdigest()
"""Identity of the kernel's source code."""


def compile_function(**options: Any) -> Callable[[Function], Function]:  # noqa: ANN401 - options of numba, of many types
    """Return numba's ``njit``, without the counting of references to arrays.

    The kernel allocates nothing and keeps nothing, so the counts are of no use. Numba drops them itself, but not
    around a branch that depends on data; there, counting for each pair costs several times what the physics does.

    With ``cache`` the files on disk bear the identity of the sources in their names. Numba itself looks at the file of
    the outermost function only, so an edited contact law would run with yesterday's machine code; and it fails where
    classes that it finds in files of another calcidem have gone.
    """

    def decorate(function: Function) -> Function:
        if options.get("cache"):
            function.__qualname__ += f"_{SOURCES[:16]}"
        compiled: Function = njit(_nrt=False, **options)(function)  # type: ignore[call-overload]
        return compiled

    return decorate


# Only compiled code calls these, so they need no entry for Python; making those took a third of the compile time.
inline = compile_function(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def target_processor() -> tuple[str, tuple[str, ...]]:
    """LLVM's names of the processor that kernels are compiled for and of its features, numba's settings included."""
    name, features = (getattr(config, setting) for setting in ("CPU_NAME", "CPU_FEATURES"))
    if features is None:
        features = codegen.get_host_cpu_features()  # type: ignore[no-untyped-call]
    known = tuple(part[1:] for part in features.split(",") if part.startswith("+"))
    return name or binding.get_host_cpu_name(), known
