import runpy
from pathlib import Path

import pytest

from calcidem.dem.kernels import compiling


def test_compiled_code_of_other_sources_is_not_even_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What another calcidem has left in the cache on disk, be it unreadable, is passed over; its own is used again."""
    program = tmp_path / "adder.py"
    program.write_text("def add(x):\n    return x + 1\n")
    for sources in ("a" * 64, "b" * 64):
        monkeypatch.setattr(compiling, "SOURCES", sources)
        assert compiling.compile_function(cache=True)(runpy.run_path(str(program))["add"])(1) == 2
        (index,) = tmp_path.rglob(f"*{sources[:16]}*.nbi")
        index.write_bytes(b"classes that have gone")
    monkeypatch.setattr(compiling, "SOURCES", "c" * 64)
    for hits in (0, 1):
        function = compiling.compile_function(cache=True)(runpy.run_path(str(program))["add"])
        assert function(1) == 2
        assert sum(function.stats.cache_hits.values()) == hits
