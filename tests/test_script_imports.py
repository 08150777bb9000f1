"""Scripts beside the package import names that it has."""

import ast
import importlib.util
from pathlib import Path

import pytest
from places import CHECKOUT

FOLDERS = ("benchmarks", "docs", "examples", "scripts")
SCRIPTS = sorted(file for folder in FOLDERS for file in (CHECKOUT / folder).rglob("*.py") if ".venv" not in file.parts)


def missing_names(source: str) -> list[str]:
    """Names that a script imports from calcidem, at its top or in a function, and that are not there."""
    missing = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            wanted = [(name.name, None) for name in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            wanted = [(node.module, name.name) for name in node.names]
        else:
            continue
        missing += [f"{module}.{name or ''}" for module, name in wanted if not _is_there(module, name)]
    return missing


def _is_there(module: str, name: str | None) -> bool:
    if module.split(".", maxsplit=1)[0] != "calcidem":
        return True
    try:
        found = importlib.import_module(module)
    except ImportError:
        return False
    return name in (None, "*") or hasattr(found, str(name)) or _is_module(module, str(name))


def _is_module(module: str, name: str) -> bool:
    return importlib.util.find_spec(f"{module}.{name}") is not None


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda file: str(file.relative_to(CHECKOUT)))
def test_scripts_import_names_that_exist(script: Path) -> None:
    """No script of benchmarks, docs, examples or scripts imports a name that calcidem has lost."""
    assert missing_names(script.read_text(encoding="utf-8")) == []


def test_a_lost_name_is_found() -> None:
    """A name that a module does not have, a module that is not there, and an import within a function are found."""
    lost = "from calcidem.dem import start, was_removed\ndef f():\n    from calcidem.no_such_room import thing\n"
    assert missing_names(lost) == ["calcidem.dem.was_removed", "calcidem.no_such_room.thing"]
    assert missing_names("import calcidem.no_such_room") == ["calcidem.no_such_room."]
