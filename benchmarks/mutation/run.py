"""Whether the tests of a room notice small errors in it: one at a time is put into a copy of the package.

    pip install pytest-cov
    python benchmarks/mutation/run.py [--rooms analysis sweep dem] [--mutants 400] [--seed 1]

`tests/test_sentinels.py` keeps twenty of them; `equivalent.md` lists those that no test can notice.

A mutant moves a number, or exchanges a sign, an operator, a comparison or a logical word. It is judged by the tests of the
room that run its line, then by the files that import its module, first of the room and then of all rooms, and by the
bits that are kept in the tree, since programs that tests start, and lines that run at import, are not seen. Kernels are
left out, since each mutant of one would be compiled anew; their naive twins
(tests/dem/test_naive.py) compare every term of them. Prints the survivors, and the share of killed mutants of each room.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[2]
TIME_LIMIT = 600.0
"""Seconds after which a mutant that hangs its tests counts as killed."""

_OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
"""How an operator is spelled, and what is put in its place."""


@dataclass(frozen=True, order=True)
class Mutant:
    """An error: a piece of one line of a module, and what stands there instead."""

    module: Path
    line: int
    begin: int
    end: int
    instead: str

    def apply(self, package: Path) -> str:
        """Put the error into a copy of the package; give the line as it was."""
        path = package / self.module
        lines = path.read_bytes().splitlines(keepends=True)
        line = lines[self.line - 1]
        lines[self.line - 1] = line[: self.begin] + self.instead.encode() + line[self.end :]
        path.write_bytes(b"".join(lines))
        return line.decode().strip()


def mutants(room: str) -> Iterator[Mutant]:
    """All mutants of a room."""
    for path in sorted((CHECKOUT / "calcidem" / room).rglob("*.py")):
        if "kernels" not in path.parts and "figures" not in path.parts:
            source = path.read_bytes()
            yield from _of_module(path.relative_to(CHECKOUT), ast.parse(source), source.splitlines())


def _of_module(module: Path, tree: ast.AST, lines: list[bytes]) -> Iterator[Mutant]:
    """Mutants of a module; annotations and texts stay."""
    annotated = {
        id(node)
        for owner in ast.walk(tree)
        for name in ("annotation", "returns")
        if isinstance(getattr(owner, name, None), ast.AST)
        for node in ast.walk(getattr(owner, name))
    }
    for node in ast.walk(tree):
        if id(node) in annotated:
            continue
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            moved = node.value + 1 if isinstance(node.value, int) else 1.3 * node.value or 0.1
            yield Mutant(module, node.lineno, node.col_offset, node.end_col_offset or 0, repr(moved))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            yield Mutant(module, node.lineno, node.col_offset, node.operand.col_offset, "")
        for left, operator, right in _sides(node):
            if left.end_lineno == right.lineno and type(operator) in _OPERATORS:
                spelled, instead = _OPERATORS[type(operator)]
                place = lines[right.lineno - 1].find(spelled.encode(), left.end_col_offset, right.col_offset)
                if place >= 0:
                    yield Mutant(module, right.lineno, place, place + len(spelled), instead)


def _sides(node: ast.AST) -> Iterator[tuple[ast.expr, ast.AST, ast.expr]]:
    """Operators of an expression, each between its sides."""
    if isinstance(node, ast.BinOp):
        yield node.left, node.op, node.right
    elif isinstance(node, ast.Compare):
        yield from zip([node.left, *node.comparators[:-1]], node.ops, node.comparators, strict=True)
    elif isinstance(node, ast.BoolOp):
        yield from ((left, node.op, right) for left, right in pairwise(node.values))


def tests_by_line(room: str) -> dict[tuple[str, int], set[str]]:
    """Tests of a room that run each line of the package; one may fail, since they are slower when they are followed."""
    from coverage import CoverageData  # noqa: PLC0415 - nothing else here needs it

    with tempfile.TemporaryDirectory(prefix="calcidem-mutant-") as folder:
        environment = os.environ | {"COVERAGE_FILE": f"{folder}/lines"}
        command = [sys.executable, "-m", "pytest", "-q", "--cov=calcidem", "--cov-context=test", "--cov-report="]
        subprocess.run([*command, f"tests/{room}"], cwd=CHECKOUT, env=environment, check=False)
        data = CoverageData(f"{folder}/lines")
        data.read()
        return {
            (str(Path(file).relative_to(CHECKOUT)), line): {name.partition("|")[0] for name in names if name}
            for file in data.measured_files()
            for line, names in data.contexts_by_lineno(file).items()
        }


def judges(room: str, module: Path) -> list[list[str]]:
    """Files of tests that import the module: of the room, its own one first, or all of the room; then of other rooms.

    Bits that are kept in the tree judge the engine as well: a program computes them.
    """
    dotted = ".".join(module.with_suffix("").parts)
    files = sorted((CHECKOUT / "tests").rglob("test_*.py"))
    found = [file for file in files if f"{dotted} import" in file.read_text(encoding="utf-8")]
    found.sort(key=lambda file: file.stem != f"test_{module.stem}")
    own = CHECKOUT / "tests" / room
    here = [file for file in found if own in file.parents] or [file for file in files if own in file.parents]
    bits = [CHECKOUT / "tests" / "dem" / "test_portable_bits.py"] if room == "dem" else []
    return [[str(file) for file in dict.fromkeys([*here, *bits])], [str(file) for file in found if file not in here]]


def is_killed(mutant: Mutant, room: str, tests: set[str]) -> tuple[bool, str]:
    """Whether a test fails with the error in the package, and the line that has it; ``tests`` run this line."""
    with tempfile.TemporaryDirectory(prefix="calcidem-mutant-") as folder:
        shutil.copytree(CHECKOUT / "calcidem", Path(folder) / "calcidem")  # with the compiled kernels
        line = mutant.apply(Path(folder))
        seen = sorted(str(CHECKOUT / test) for test in tests)
        # Lines that run at import are not seen; any test of the room may know them.
        chosen = (seen or [str(CHECKOUT / "tests" / room)], *judges(room, mutant.module))
        return any(_fails(folder, tests) for tests in chosen if tests), line


def _fails(folder: str, chosen: list[str]) -> bool:
    """Whether a test fails with the package in a folder."""
    options = ["-x", "-q", "--no-header", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
    environment = os.environ | {"PYTHONPATH": folder}  # for programs that the tests start
    command = [sys.executable, "-m", "pytest", *options, "--rootdir", str(CHECKOUT), *chosen]
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, timeout=TIME_LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        return True
    return done.returncode != 0


def main() -> None:
    """Judge, and print the survivors and the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", nargs="+", default=["analysis", "sweep", "dem"])
    parser.add_argument("--mutants", type=int, default=400, help="of all rooms together")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    pool = [(room, mutant) for room in given.rooms for mutant in sorted(set(mutants(room)))]
    chosen = random.Random(given.seed).sample(pool, min(given.mutants, len(pool)))
    for room in given.rooms:
        of_room = [mutant for owner, mutant in chosen if owner == room]
        if of_room and is_killed(Mutant(of_room[0].module, 1, 0, 0, ""), room, set())[0]:
            sys.exit(f"{room}: tests fail without any error in the package")
        tests, killed = tests_by_line(room), 0
        for mutant in of_room:
            noticed, line = is_killed(mutant, room, tests.get((str(mutant.module), mutant.line), set()))
            killed += noticed
            if not noticed:
                place = f"{mutant.module}:{mutant.line}:{mutant.begin}"
                print(f"survived: {place}: {line}   here: {mutant.instead or 'nothing'}", flush=True)
        print(f"{room}: {killed} of {len(of_room)} mutants killed", flush=True)


if __name__ == "__main__":
    main()
