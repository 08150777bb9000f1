"""Trial reading of a NetCDF file in a separate process, since reading some damaged files never ends.

This module is also the program of that process. Its arguments are the file, the seconds for opening it and for each
block, and the part to read: ``all`` or ``names``. The exit code is 0 if the file was read or refused within that time.
"""

import faulthandler
import math
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from calcidem.input_file import open_input
from calcidem.storage.errors import DamagedStoreError

_TIME_FOR_A_BLOCK = 30.0
"""Seconds for opening a file, and for reading each block."""

_ERRORS_OF_READING = (OSError, RuntimeError, AttributeError, LookupError, TypeError, ValueError, ArithmeticError)


def refuse_unreadable(path: str | os.PathLike[str], *, names_only: bool = False) -> None:
    """Refuse a file on which the NetCDF library loops or crashes; files that the library itself refuses pass.

    With ``names_only`` the file is only opened. `InputFileError` if it is not a regular file; `DamagedStoreError` if
    opening or reading it does not end, or a variable is larger than the file can be unpacked to.
    """
    file = Path(path).absolute()
    with open_input(file):
        pass
    arguments = [str(file), str(_TIME_FOR_A_BLOCK), "names" if names_only else "all"]
    ended = subprocess.run(  # noqa: S603 - this module
        [sys.executable, "-P", "-m", __name__, *arguments],
        check=False,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={"HDF5_USE_FILE_LOCKING": "FALSE"} | os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    if ended.returncode != 0:
        raise DamagedStoreError(
            f"{path} is damaged: the NetCDF library does not finish reading it, or a variable has more than it stores.",
            "Export it again from its database; nothing was written.",
        )


def _read_file(path: str, seconds: float, amount: str) -> None:
    """Open and read the file; a thread that needs no lock ends the process if reading does not return."""
    import netCDF4  # noqa: PLC0415 - the process that starts this one sets how it locks files first

    faulthandler.dump_traceback_later(seconds, exit=True)
    with suppress(*_ERRORS_OF_READING), netCDF4.Dataset(path, "r") as file:
        file.set_auto_mask(False)
        if amount == "all":
            _read(file, seconds, 1100 * Path(path).stat().st_size)  # bytes; deflate packs at most 1032 into one


def _read(group: Any, seconds: float, most: int) -> None:  # noqa: ANN401 - the library has no types
    """Read all variables of a group and of those in it; one of more than `most` bytes ends the process."""
    for variable in group.variables.values():
        if math.prod(variable.shape) * getattr(variable.dtype, "itemsize", 8) > most:
            sys.exit(1)
        with suppress(*_ERRORS_OF_READING):
            rows = max((1 << 20) // (math.prod(variable.shape[1:]) or 1), 1)  # a million elements at a time
            for start in range(0, variable.shape[0] if variable.shape else 1, rows):
                faulthandler.dump_traceback_later(seconds, exit=True)
                _ = variable[start : start + rows] if variable.shape else variable[...]
    for inner in group.groups.values():
        _read(inner, seconds, most)


if __name__ == "__main__":
    _read_file(sys.argv[1], float(sys.argv[2]), sys.argv[3])
