"""Each constant of the reading is held by its tests: moved by 30 % up or down, one of them fails."""

import ast
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from changed_copy import run_with_copy
from places import CHECKOUT

WAVE = CHECKOUT / "calcidem" / "dem" / "wave"
JUDGES = ["tests/dem/test_reading.py", "tests/dem/test_section.py"]


def constants() -> Iterator[tuple[str, str]]:
    """Module and name of each number of the reading and of the section, and of the stations."""
    for module in ("reading", "section", "domain"):
        for node in ast.parse((WAVE / f"{module}.py").read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant | ast.BinOp):
                name = ast.unparse(node.targets[0])
                if module != "domain" or name == "_STATIONS":
                    yield module, name


def judge(folder: Path, module: str, name: str, factor: float) -> subprocess.CompletedProcess[str]:
    """Run the tests with a copy of the package in which a constant is another one; whole numbers stay whole."""

    def change(source: str) -> str:
        value = next(
            node.value
            for node in ast.parse(source).body
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name
        )
        number = eval(ast.unparse(value))  # noqa: S307 - a number of our own source
        moved = round(factor * number) if isinstance(number, int) else factor * number
        lines = source.splitlines(keepends=True)
        lines[value.lineno - 1] = f"{name} = {moved!r}\n"
        return "".join(lines)

    return run_with_copy(folder, f"dem/wave/{module}.py", change, JUDGES)


@pytest.mark.full
def test_the_constants_as_they_are_pass(tmp_path: Path) -> None:
    """Or what follows would prove nothing."""
    done = judge(tmp_path, "reading", "SILENCE", 1.0)
    assert done.returncode == 0, done.stdout


@pytest.mark.full
@pytest.mark.parametrize("factor", [0.7, 1.3])
@pytest.mark.parametrize(("module", "name"), list(constants()))
def test_a_constant_that_is_moved_is_noticed(tmp_path: Path, module: str, name: str, factor: float) -> None:
    """A test fails, and it is a test, not an import."""
    done = judge(tmp_path, module, name, factor)
    assert done.returncode == 1, done.stdout
    assert "FAILED" in done.stdout
    assert "error" not in done.stdout.splitlines()[-1]
