"""Processes of tests, forked from one with the libraries loaded: each is there at once instead of after seconds."""

import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory

_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(
    [
        "calcidem.app.cli.run",
        "calcidem.app.campaign.run",
        "calcidem.app.report.page",
        "calcidem.app.studies.calibrate",
        "calcidem.analysis.figures.registry",
        "calcidem.dem.wave.measurement",
        "calcidem.storage.netcdf",
        "scipy.stats",
        "xarray",
    ]
)


def run_forked(
    words: Sequence[str], folder: Path, variables: Mapping[str, str], patience: float
) -> tuple[int, str, str]:
    """Run ``calcidem WORDS`` in a folder; give its exit code and what it wrote to both streams.

    Raises
    ------
    TimeoutError
        It has not ended within ``patience`` seconds, and is killed.
    """
    with TemporaryDirectory() as place:
        written = [Path(place) / name for name in ("output", "errors")]
        process = _SERVER.Process(target=_be_command, args=(words, folder, dict(variables), written))
        process.start()
        process.join(patience)
        hangs = process.exitcode is None
        process.kill()
        process.join()
        output, errors = (path.read_text(errors="replace") if path.exists() else "" for path in written)
    if hangs:
        raise TimeoutError(f"still running after {patience} s:\n{output}\n{errors}")
    return process.exitcode, output, errors


def _be_command(words: Sequence[str], folder: Path, variables: Mapping[str, str], written: Sequence[Path]) -> None:
    """Take the surroundings of the command, and be it."""
    for number, path in enumerate(written, 1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    sys.argv = ["calcidem", *words]
    from calcidem.app.cli.main import main  # noqa: PLC0415 - the process that starts the server need not load it

    main()


class ForkedProgram:
    """A program in Python that runs in the folder of the test, as much of `subprocess.Popen` as tests of kills need."""

    def __init__(self, program: Path, *words: str) -> None:
        reader, writer = _SERVER.Pipe(duplex=False)
        self._process = _SERVER.Process(target=_be_program, args=(program, words, Path.cwd(), dict(os.environ), writer))
        self._process.start()
        writer.close()
        self.pid = self._process.pid
        self.stdout = os.fdopen(os.dup(reader.fileno()), encoding="utf-8")

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal."""
        os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill it, if it still runs."""
        self._process.kill()

    def poll(self) -> int | None:
        """Exit code; None while it runs."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired("program", timeout)
        return self._process.exitcode


def _be_program(
    program: Path, words: Sequence[str], folder: Path, variables: Mapping[str, str], output: Connection
) -> None:
    """Take the surroundings of the program, and be it."""
    os.dup2(output.fileno(), 1)
    output.close()
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    sys.argv = [str(program), *words]
    runpy.run_path(str(program), run_name="__main__")
