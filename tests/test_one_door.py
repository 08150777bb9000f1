"""What a user names is read through `calcidem.input_file`, and integers of the environment through `whole_number`."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import CHECKOUT

PACKAGE = CHECKOUT / "calcidem"

FROM_LIBRARIES = {
    "np": {"load", "loadtxt", "genfromtxt", "fromfile", "memmap"},
    "xr": {"open_dataset", "load_dataset", "open_datatree", "open_mfdataset"},
    "pd": {"read_csv", "read_table", "read_excel", "read_parquet", "read_hdf"},
    "netCDF4": {"Dataset", "MFDataset"},
    "zipfile": {"ZipFile"},
    "tarfile": {"open", "TarFile"},
    "gzip": {"open", "GzipFile", "decompress"},
    "bz2": {"open", "BZ2File", "decompress"},
    "lzma": {"open", "LZMAFile", "decompress"},
    "zlib": {"decompress", "decompressobj"},
    "tomllib": {"load"},
    "json": {"load"},
    "pickle": {"load"},
    "io": {"open", "FileIO"},
    "mmap": {"mmap"},
}
"""Functions that read a file or unpack its content, by the name of their module."""

OF_PATHS = {"open", "read_text", "read_bytes"}
"""Methods that read a file."""


ALLOWED = {
    ("input_file.py", "open"): "the door",
    ("input_file.py", "GzipFile"): "the door",
    ("input_file.py", "ZipFile"): "the door",
    ("storage/netcdf_trial.py", "Dataset"): "the NetCDF library opens files itself; the door looks at the file before",
    ("storage/netcdf.py", "Dataset"): "as above, after the trial; writes",
    ("storage/records.py", "ZipFile"): "writes",
    ("app/serve/server.py", "load"): "what the starting process tells",
    ("storage/sql/lease.py", "open"): "a lock, opened without following links, see there",
    ("storage/files.py", "open"): "a descriptor to flush what was written",
    ("storage/files.py", "read_text"): "of /proc",
    ("storage/records.py", "read_text"): "of /proc",
    ("storage/records.py", "read_bytes"): "of /proc",
    ("app/campaign/preview.py", "read_text"): "of /proc",
    ("app/campaign/run.py", "read_text"): "of /proc",
    ("version.py", "read_text"): "of the installed distribution",
    ("app/campaign/packing.py", "read_bytes"): "of the package",
    ("app/campaign/opened.py", "open_dataset"): "of the package",
    ("app/config/examples.py", "read_text"): "of the package",
    ("app/config/presets/__init__.py", "read_text"): "of the package",
    ("analysis/measured.py", "read_text"): "of the package",
    ("dem/kernels/compiling.py", "read_bytes"): "of the package",
    ("dem/kernels/gpu/steps.py", "read_bytes"): "of the package",
    ("app/campaign/cells.py", "open"): "writes",
    ("app/campaign/cells.py", "read_text"): "of the cache, which this program writes",
    ("app/report/page.py", "open"): "writes",
    ("app/cli/run.py", "open"): "writes",
    ("dem/sample/compaction.py", "open"): "writes",
    ("wording.py", "open"): "where nothing is kept",
    ("analysis/figures/style.py", "open"): "a picture in memory that was just drawn",
}
"""Module and call, and why it need not go through the door."""


def calls(source: str) -> Iterator[ast.Call]:
    """Calls of a module."""
    return (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call))


def reads(source: str) -> set[str]:
    """Names of what a module reads files with."""
    functions = [call.func for call in calls(source)]
    methods = [function for function in functions if isinstance(function, ast.Attribute)]
    return {
        *(method.attr for method in methods if method.attr in OF_PATHS),
        *(method.attr for method in methods if method.attr in FROM_LIBRARIES.get(ast.unparse(method.value), ())),
        *("open" for function in functions if ast.unparse(function) == "open"),
    }


def integers_of_the_environment(source: str) -> list[str]:
    """Conversions of a variable of the environment to a number."""
    converted = (ast.unparse(call) for call in calls(source) if ast.unparse(call.func) in {"int", "float"})
    return [text for text in converted if "environ" in text or "variables" in text or "getenv" in text]


def modules() -> Iterator[tuple[str, str]]:
    """Name and source of each module."""
    for path in sorted(PACKAGE.rglob("*.py")):
        yield path.relative_to(PACKAGE).as_posix(), path.read_text(encoding="utf-8")


def test_nothing_is_read_beside_the_door() -> None:
    """Each other way of reading is one of a short list, with its reason; and the list has no more than there is."""
    found = {(name, call) for name, source in modules() for call in reads(source)}
    assert found - ALLOWED.keys() == set(), "read it with calcidem.input_file"
    assert ALLOWED.keys() - found == set(), "no longer there"


def test_integers_of_the_environment_have_bounds() -> None:
    """`whole_number` alone converts them."""
    assert [(name, text) for name, source in modules() for text in integers_of_the_environment(source)] == []


@pytest.mark.parametrize(
    "source",
    [
        "open(path)",
        "path.read_text()",
        "np.load(path)",
        "zipfile.ZipFile(path)",
        "tomllib.load(file)",
        "Path(a).open()",
    ],
)
def test_other_ways_of_reading_are_seen(source: str) -> None:
    """The test above notices what it forbids."""
    assert len(reads(source)) == 1


@pytest.mark.parametrize("source", ['int(os.environ["A"])', 'float(os.environ.get("A", 1))', "int(variables[name])"])
def test_other_integers_are_seen(source: str) -> None:
    """The test above notices what it forbids."""
    assert integers_of_the_environment(source)


def test_the_list_is_of_modules() -> None:
    """Each has a reason."""
    assert all(Path(PACKAGE, name).is_file() and reason for (name, _), reason in ALLOWED.items())
