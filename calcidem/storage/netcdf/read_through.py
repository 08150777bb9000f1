"""Read a NetCDF file to its end, or end: a program of its own, since the library loops for ever on some damaged files.

Its arguments are the file, the seconds that it may take to open it or to read a block, and how much is read: ``all`` or
``names``. It ends with 0 if the file can be read, or refused, within that time.
"""

import faulthandler
import math
import sys
from contextlib import suppress
from typing import Any

import netCDF4

_BLOCK = 1 << 20
"""Elements that are read at a time."""

_ERRORS_OF_READING = (OSError, RuntimeError, AttributeError, LookupError, TypeError, ValueError, ArithmeticError)


def _read_file(path: str, seconds: float, amount: str) -> None:
    """Open the file and read it; a thread of Python's own, which needs no lock, ends the process if that hangs."""
    faulthandler.dump_traceback_later(seconds, exit=True)
    with suppress(*_ERRORS_OF_READING), netCDF4.Dataset(path, "r") as file:
        file.set_auto_mask(False)
        if amount == "all":
            _read(file, seconds)


def _read(group: Any, seconds: float) -> None:  # noqa: ANN401 - the library has no types
    """Read all variables of a group and of those in it."""
    for variable in group.variables.values():
        with suppress(*_ERRORS_OF_READING):
            rows = max(_BLOCK // (math.prod(variable.shape[1:]) or 1), 1)
            for start in range(0, variable.shape[0] if variable.shape else 1, rows):
                faulthandler.dump_traceback_later(seconds, exit=True)
                _ = variable[start : start + rows] if variable.shape else variable[...]
    for inner in group.groups.values():
        _read(inner, seconds)


if __name__ == "__main__":
    _read_file(sys.argv[1], float(sys.argv[2]), sys.argv[3])
