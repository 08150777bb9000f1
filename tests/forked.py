"""The command in a process of its own that is forked from one with its libraries loaded, which saves their seconds."""

import multiprocessing
import os
import sys
from collections.abc import Mapping, Sequence
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
        "calcidem.storage.netcdf.export",
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
        if process.exitcode is None:
            process.kill()
            process.join()
        output, errors = (path.read_text(errors="replace") if path.exists() else "" for path in written)
        code = process.exitcode
        process.close()
    if code == -9:
        raise TimeoutError(f"still running after {patience} s:\n{output}\n{errors}")
    return code, output, errors


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
