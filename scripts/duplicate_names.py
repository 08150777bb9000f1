"""List names that more than one module of the package defines: one concept has one name, and one name one concept.

Counted are functions, classes and constants at the top of a module, with or without an underscore before them. Left out
are type variables and what Python itself names, such as a module's `__getattr__`. `tests/test_dialect.py` runs this.
"""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "calcidem"

REASONS: dict[str, str] = {}
"""Names that may stand in several modules, and why."""


def names_of(node: ast.stmt) -> Iterator[str]:
    """Names that a statement at the top of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.Assign | ast.AnnAssign) and not is_type_variable(node):
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            yield from (part.id for part in ast.walk(target) if isinstance(part, ast.Name))


def is_type_variable(node: ast.Assign | ast.AnnAssign) -> bool:
    """Whether a statement makes a type variable."""
    return isinstance(node.value, ast.Call) and ast.unparse(node.value.func).endswith("TypeVar")


def defined_names(source: str) -> Iterator[str]:
    """Names of the functions, classes and constants at the top of a module."""
    for node in ast.parse(source).body:
        yield from names_of(node)


def duplicate_names(package: Path = PACKAGE) -> dict[str, list[str]]:
    """Modules of each name that stands in several, without leading underscores."""
    modules = defaultdict(set)
    for path in package.rglob("*.py"):
        for name in defined_names(path.read_text(encoding="utf-8")):
            if not name.startswith("__"):
                modules[name.lstrip("_")].add(str(path.relative_to(package)))
    return {name: sorted(where) for name, where in sorted(modules.items()) if len(where) > 1}


if __name__ == "__main__":
    found = duplicate_names()
    for name, where in found.items():
        print(f"{name}: {', '.join(where)}{'; ' + REASONS[name] if name in REASONS else ''}")
    print(f"{len(found)} names in more than one module")
