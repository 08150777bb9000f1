"""Files that are written completely or not at all, and never replace a database."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calcidem.storage.errors import OutputRefusedError

_SQLITE = b"SQLite format 3\0"
_HDF5 = b"\x89HDF\r\n\x1a\n"
_BESIDE_A_DATABASE = ("-wal", "-shm", "-journal", ".lock")
"""Endings of the files of SQLite and of the lease beside a database."""

_BEGIN_A_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\N{FULLWIDTH EQUALS SIGN}", "\N{FULLWIDTH COMMERCIAL AT}")
"""First characters of texts that spreadsheets evaluate."""

_CURE = "Give another file name for the result; nothing was written."


@contextmanager
def write_atomically(path: str | os.PathLike[str], *, replaces_netcdf: bool = False) -> Iterator[Path]:
    """Yield a temporary file that replaces `path` once the block has ended without error and the file is on disk.

    It is in the folder of `path`, since only within a file system a file is renamed in one step. Its name is unique.
    After an error `path` is unchanged. Set ``replaces_netcdf`` if the NetCDF file at `path` may be replaced.
    `FileNotFoundError` if the folder does not exist; `OutputRefusedError` if `path` is a database or a NetCDF file.
    """
    target = Path(path).absolute()
    refuse_to_replace(target, replaces_netcdf=replaces_netcdf)
    temporary = target.with_name(f".{target.name[:200]}.{secrets.token_hex(8)}.tmp")
    try:
        yield temporary
        _flush_to_disk(temporary)
        temporary.replace(target)
        _flush_to_disk(target.parent)
    finally:
        temporary.unlink(missing_ok=True)


def write_text_atomically(path: str | os.PathLike[str], text: str) -> None:
    """Write a text in UTF-8 as `write_atomically` does, with unchanged line ends."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")


def refuse_to_replace(path: str | os.PathLike[str], *, replaces_netcdf: bool = False) -> None:
    """Raise the errors of `write_atomically` early, before a long computation."""
    target = Path(path).absolute()
    if not target.parent.is_dir():
        raise FileNotFoundError(f"The folder {target.parent} does not exist; create it, or give another file name.")
    if target.exists() and not target.is_file():
        raise OutputRefusedError(f"{target} is a folder or a device.", _CURE)
    ends = [end for end in _BESIDE_A_DATABASE if target.name.endswith(end)]
    databases = [target.with_name(target.name.removesuffix(end)) for end in ends]
    for file in (target, *databases):
        if _beginning(file) == _SQLITE:
            what = "is a database" if file == target else f"belongs to the database {file}"
            raise OutputRefusedError(f"{target} {what}.", _CURE)
    if not replaces_netcdf and _beginning(target).startswith(_HDF5):
        raise OutputRefusedError(f"{target} is a NetCDF file.", _CURE)


def _beginning(path: Path) -> bytes:
    """First bytes of a file; empty if it does not exist or is not a file."""
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(len(_SQLITE))


def _flush_to_disk(path: Path) -> None:
    if os.name == "nt" and path.is_dir():
        return  # Windows opens no folders
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)  # flushes only writable files
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def spreadsheet_value(value: object) -> object:
    """Put an apostrophe before text of a CSV file that a spreadsheet would evaluate (OWASP, CSV Injection).

    Spreadsheets do not show the apostrophe. Numbers stay as they are.
    """
    if not isinstance(value, str) or not value.startswith(_BEGIN_A_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value
