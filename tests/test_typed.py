"""What type checkers see of an installed calcidem."""

import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PROGRAM = """
import calcidem
from calcidem.dem import Scene

with calcidem.open_campaign("paper.db") as campaign:
    reveal_type(campaign.vs())
    reveal_type(campaign.recorded_section(seed=3, content=5.0).sampling_interval)
    reveal_type(next(campaign.select(content=5.0)).vs)


def modulus(scene: Scene) -> float:
    reveal_type(scene.sand)
    return scene.sand.shear_modulus
"""


@pytest.fixture(scope="module")
def fresh_python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of a new environment with calcidem's wheel in it; the libraries it needs are lent by this one."""
    wheel = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is not installed").WheelBuilder(str(ROOT))
    built = Path(next(wheel.build(directory=str(tmp_path_factory.mktemp("wheel")))))
    environment = tmp_path_factory.mktemp("fresh")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
    python = environment / "bin" / "python"
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(subprocess.run([python, "-c", ask], check=True, capture_output=True, text=True).stdout.strip())
    zipfile.ZipFile(built).extractall(packages)
    (packages / "lent.pth").write_text(sysconfig.get_path("purelib"))
    return python


@pytest.mark.full
def test_a_strict_program_finds_the_types_of_an_installed_wheel(fresh_python: Path, tmp_path: Path) -> None:
    """Strict mypy accepts a program on the installed package and knows what its calls return."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--python-executable", str(fresh_python)]
    found = subprocess.run(
        [*command, "--cache-dir", str(tmp_path / "cache"), str(program)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert found.returncode == 0, found.stdout + found.stderr
    shown = [line.split("Revealed type is ")[1] for line in found.stdout.splitlines() if "Revealed type" in line]
    assert [text.count("Any") for text in shown] == [0, 0, 0, 0], shown
    assert "DataArray" in shown[0]
    assert "float" in shown[1]
    assert "float" in shown[2]
    assert "Sand" in shown[3]
