import gc
import importlib
from pathlib import Path

import pytest

from calcidem.dem.kernels import compiling


def test_compiled_code_of_other_sources_is_not_even_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What another calcidem has left in the cache on disk, be it unreadable, is passed over; its own is used again."""
    (tmp_path / "small_adder.py").write_text("def add(x):\n    return x + 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    # a module: Numba imports it by its name where the function that was compiled a moment ago has been collected
    module = importlib.import_module("small_adder")
    for sources in ("a" * 64, "b" * 64):
        monkeypatch.setattr(compiling, "SOURCES", sources)
        assert compiling.compile_function(cache=True)(importlib.reload(module).add)(1) == 2
        (index,) = tmp_path.rglob(f"*{sources[:16]}*.nbi")
        index.write_bytes(b"classes that have gone")
    monkeypatch.setattr(compiling, "SOURCES", "c" * 64)
    for hits in (0, 1):
        gc.collect()
        function = compiling.compile_function(cache=True)(importlib.reload(module).add)
        assert function(1) == 2
        assert sum(function.stats.cache_hits.values()) == hits


def test_functions_that_are_compiled_are_told() -> None:
    """Each is named as it begins, with the number of those that are finished; what is compiled already is not told."""
    told: list[tuple[str, int]] = []
    double = compiling.compile_function()(lambda x: 2 * x)
    with compiling.watch_compiling(lambda *told_now: told.append(told_now)):
        assert [double(3), double(4), double(5.0)] == [6, 8, 10.0]
    assert told == [("<lambda>", 0), ("<lambda>", 1)]
    assert double(1j) == 2j
    assert len(told) == 2
