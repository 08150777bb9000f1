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
import json, os, sys
from pathlib import Path
import sqlalchemy
from calcidem.app.cli.main import main
for name, words in json.loads(sys.argv[1]).items():
    if os.fork():
        assert os.wait()[1] == 0, name
        continue
    sys.argv[1:] = words
    try:
        if words:
            main()
        else:
            import calcidem.app.report.page
    except SystemExit as end:
        assert not end.code, end.code
    Path(name + ".json").write_text(json.dumps(sorted(sys.modules)))
    os._exit(0)
"""
"""Each command, and without words the module of the page, in a process forked from one with what all of them need."""

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
def loaded(small_database: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder with the modules that each command has imported."""
    folder = tmp_path_factory.mktemp("loaded")
    words = {
        name: [str(small_database) if word == "DB" else word for word in words]
        for name, (words, _) in QUESTIONS.items()
    }
    subprocess.run(
        [sys.executable, "-c", _PROGRAM, json.dumps(words | {"page": []})],
        check=True,
        stdout=subprocess.DEVNULL,
        cwd=folder,
    )
    return folder


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_command_imports_what_it_needs(question: str, loaded: Path) -> None:
    """A command that only reads or moves stored numbers loads neither the engine nor the libraries of figures."""
    _, most = QUESTIONS[question]
    modules = set(json.loads((loaded / f"{question}.json").read_text()))
    assert modules & {*_LIBRARIES, *_PARTS} <= _NEEDED.get(question, set())
    assert len(modules) <= most, len(modules)
    if question in {"query", "status", "show", "export"}:
        assert not {name for name in modules if name.startswith("calcidem.dem")}


def test_a_report_needs_no_kernel(loaded: Path) -> None:
    """What makes the page loads neither numba nor the engine: it shows what was computed."""
    assert not set(json.loads((loaded / "page.json").read_text())) & {"numba", "networkx", *_PARTS}
