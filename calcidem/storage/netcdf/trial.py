"""NetCDF files from elsewhere are read by a process that can be ended before they are read by this one."""

import os
import subprocess
import sys
from pathlib import Path

from calcidem.storage.errors import DamagedStoreError, StoreUnavailableError
from calcidem.storage.netcdf import read_through

_TIME_FOR_A_BLOCK = 30.0
"""Seconds for opening a file, and for each block that is read of it."""


def refuse_unreadable(path: str | os.PathLike[str], *, names_only: bool = False) -> None:
    """Refuse a file that makes the library for NetCDF loop or crash; what the library itself refuses is not judged.

    Parameters
    ----------
    path : str or path
    names_only : bool
        Whether the file is only to be opened, and nothing but its attributes to be read.

    Raises
    ------
    StoreUnavailableError
        If it is no file, such as a pipe, which would be waited for.
    DamagedStoreError
        If opening or reading it does not come to an end.
    """
    file = Path(path).absolute()
    if not file.is_file():
        what = "is not a file" if file.exists() else "does not exist"
        raise StoreUnavailableError(f"{path} {what}.", "Check the name.")
    program, amount = str(Path(read_through.__file__).absolute()), "names" if names_only else "all"
    ended = subprocess.run(  # noqa: S603 - our own program
        [sys.executable, program, str(file), str(_TIME_FOR_A_BLOCK), amount],
        check=False,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    if ended.returncode != 0:
        raise DamagedStoreError(
            f"{path} is damaged: the library for NetCDF does not come to an end with it.",
            "Export it again from its database; nothing was written.",
        )
