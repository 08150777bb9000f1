"""What a command imports before it answers: no timing, only modules."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

_LIBRARIES = ("matplotlib", "multiprocessing", "networkx", "numba", "pandas", "scipy.special", "scipy.stats", "xarray")
_PARTS = ("calcidem.dem.engine.assembly", "calcidem.dem.kernels.steps")
"""What takes a tenth of a second and more to import: libraries, and the engine with its kernels."""

_PROGRAM = """
import json, sys
from calcidem.app.cli.main import main
sys.argv[1:] = json.loads(sys.argv[1])
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
sys.stderr.write(json.dumps(sorted(sys.modules)))
"""

QUESTIONS = {
    "query": (["query", "DB"], 600),
    "status": (["status", "DB"], 640),
    "show": (["show", "DB", "--seed", "1", "--content", "0.66"], 640),
    "export": (["export", "DB", "out.nc"], 600),
    "import": (["import", "out.nc", "--db", "copy.db"], 840),
    "predict": (["predict", "DB"], 1900),
}
"""Commands, and the modules that each may import; 380 are those of Python, NumPy and SQLAlchemy alone."""

_NEEDED = {
    "predict": {"multiprocessing", "pandas", "scipy.special", "scipy.stats", "xarray"},
    "import": {"scipy.special"},  # a packing from elsewhere is checked
}


@pytest.fixture(scope="module")
def exported(small_database: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give an exported file of the small campaign."""
    from calcidem.storage.netcdf import export_netcdf  # noqa: PLC0415 - what is tested is what others import
    from calcidem.storage.sql.store import read_campaign  # noqa: PLC0415

    with read_campaign(small_database) as store:
        return export_netcdf(store, tmp_path_factory.mktemp("exported") / "small.nc")


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_command_imports_what_it_needs(question: str, small_database: Path, exported: Path, tmp_path: Path) -> None:
    """A command that only reads or moves stored numbers loads neither the engine nor the libraries of figures."""
    arguments, most = QUESTIONS[question]
    places = {"DB": str(small_database), "out.nc": str(exported if question == "import" else tmp_path / "out.nc")}
    command = [places.get(word, word) for word in arguments]
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, json.dumps(command)], check=True, capture_output=True, text=True, cwd=tmp_path
    )
    modules = set(json.loads(done.stderr.splitlines()[-1]))
    assert modules & {*_LIBRARIES, *_PARTS} <= _NEEDED.get(question, set())
    assert len(modules) <= most, len(modules)
    if question in {"query", "status", "show", "export"}:
        assert not any(name.startswith("calcidem.dem") for name in modules)


def test_a_report_needs_no_kernel() -> None:
    """What makes the page loads neither numba nor the engine: it shows what was computed."""
    program = "import sys, calcidem.app.report.page; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert not {*done.stdout.split()} & {"numba", "networkx", *_PARTS}
