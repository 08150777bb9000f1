"""The habits of the code that no linter knows, see CONTRIBUTING.md."""

import ast
import re
import runpy
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "calcidem"
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "duplicate_names.py"))
MODULES = sorted(PACKAGE.rglob("*.py"))
MOST_DUPLICATES = 14
MOST_LINES = 5_700
"""Of a room: a larger one has something in it that wants a room of its own."""

TESTS_STILL_COUNT = ("calcidem.dem.kernels", "calcidem.dem.wave")
"""Rooms with names that only tests use."""


@cache
def tree_of(path: Path) -> ast.Module:
    """Syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def module_name(path: Path) -> str:
    """Dotted name of a module of the package."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def other_python_files() -> Iterator[Path]:
    """Python files outside the package that use it as people do: tests may look inside."""
    for folder in ("benchmarks", "docs", "examples", "scripts"):
        yield from (ROOT / folder).rglob("*.py")


def taken_names(path: Path) -> Iterator[tuple[str, str]]:
    """Module and name of all that a file takes from the package, by an import or as an attribute of a module."""
    aliases: dict[str, str] = {}
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from ((node.module, entry.name) for entry in node.names)
            aliases |= {entry.asname or entry.name: f"{node.module}.{entry.name}" for entry in node.names}
        elif isinstance(node, ast.Import):
            aliases |= {entry.asname or entry.name: entry.name for entry in node.names}
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Attribute) and (module := aliases.get(ast.unparse(node.value))):
            yield module, node.attr
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("setattr"):
            target, name, *_ = (ast.unparse(argument) for argument in node.args)
            yield aliases.get(target, ""), name.strip("'")


@cache
def uses() -> dict[str, set[str]]:
    """Names that other files use of each module of the package."""
    found: dict[str, set[str]] = {module_name(path): set() for path in MODULES}
    for path in (*MODULES, *other_python_files()):
        for module, name in taken_names(path):
            found.get(module, set()).add(name)
    for path in (ROOT / "tests").rglob("*.py"):
        for module, name in taken_names(path):
            if module.startswith(TESTS_STILL_COUNT) and not name.startswith("_"):
                found.get(module, set()).add(name)
    # What is imported only when it is needed stands in these files by its name.
    lazy = (ROOT / "pyproject.toml", PACKAGE / "__init__.py", PACKAGE / "app" / "cli" / "__init__.py")
    named = {name for path in lazy for name in re.findall(r"\w+", path.read_text(encoding="utf-8"))}
    for module, names in found.items():
        if module.startswith(("calcidem.app.cli", "calcidem.app.campaign")):
            names.update(named)
            names.add(f"{module.rpartition('.')[2].rstrip('_')}_command")
    return found


def annotations_of(function: ast.FunctionDef) -> list[ast.expr | None]:
    """Annotations of a function's arguments and of its result."""
    return [function.returns, *(node.annotation for node in ast.walk(function.args) if isinstance(node, ast.arg))]


def signature_of(node: ast.stmt) -> list[ast.expr | None]:
    """What a reader has to know of a function, class or constant in order to use it: annotations and bases."""
    if isinstance(node, ast.FunctionDef):
        return annotations_of(node)
    if isinstance(node, ast.ClassDef):
        fields = [inner.annotation for inner in node.body if isinstance(inner, ast.AnnAssign)]
        methods = [inner for inner in node.body if isinstance(inner, ast.FunctionDef)]
        return [*node.bases, *fields, *(part for method in methods for part in annotations_of(method))]
    if isinstance(node, ast.AnnAssign):
        return [node.annotation, node.value if "TypeAlias" in ast.unparse(node.annotation) else None]
    return [node.value] if isinstance(node, ast.Assign) else []


def public_through_signatures(tree: ast.Module, public: set[str]) -> set[str]:
    """Names of a module that stand in the signature of something public in it, and those that are public anyway."""
    statements = {name: node for node in tree.body for name in SCRIPT["names_of"](node)}
    reached, todo = set(public), list(public)
    while todo:
        node = statements.get(todo.pop())
        words = (
            {word for part in signature_of(node) if part for word in re.findall(r"\w+", ast.unparse(part))}
            if node
            else set()
        )
        new = (words & statements.keys()) - reached
        reached |= new
        todo += new
    return reached


def exceptions_of(tree: ast.Module) -> set[str]:
    """Exceptions that a module defines: whoever catches them may stand outside this tree."""
    return {node.name for node in tree.body if isinstance(node, ast.ClassDef) and node.name.endswith("Error")}


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_an_underscore_tells_what_a_module_keeps_to_itself(path: Path) -> None:
    """Names with an underscore are used in their own module only, names without one elsewhere too."""
    tree = tree_of(path)
    names = set(SCRIPT["defined_names"](path.read_text(encoding="utf-8"))) - {"__all__", "__getattr__", "__version__"}
    outside = uses()[module_name(path)]
    public = public_through_signatures(tree, outside | exceptions_of(tree))
    assert sorted(name for name in names if name.startswith("_") and name in outside) == []
    assert sorted(name for name in names if not name.startswith("_") and name not in public) == []


def test_a_name_stands_for_one_concept() -> None:
    """Fewer than 15 names are defined in more than one module, and each of these has its reason."""
    found = SCRIPT["duplicate_names"]()
    assert len(found) <= MOST_DUPLICATES
    assert set(found) == set(SCRIPT["REASONS"])


def test_annotations_are_evaluated() -> None:
    """No module postpones its annotations."""
    assert [path for path in MODULES if "from __future__" in path.read_text(encoding="utf-8")] == []


def test_app_consists_of_rooms() -> None:
    """No module stands loose in `calcidem.app`."""
    assert [path.name for path in (PACKAGE / "app").glob("*.py")] == ["__init__.py"]


def test_no_room_is_too_large() -> None:
    """No folder of the second level, nor the scheduler, has more lines than a reader can hold."""
    lines: dict[str, int] = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).parts
        room = "/".join(parts[:-1][: 1 if parts[0] == "sweep" else 2])
        lines[room] = lines.get(room, 0) + len(path.read_text(encoding="utf-8").splitlines())
    assert max(lines.values()) <= MOST_LINES, lines
