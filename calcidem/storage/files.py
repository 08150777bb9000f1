"""Files that appear complete or not at all."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def write_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary file that takes the place of `path` once the block has ended without error and it is on disk.

    It is in the folder of `path`, since a file can be renamed in one step only within a file system; its name is one
    that no other process, on this machine or another, writes at the same time. After an error what was at `path` is
    as it was.

    Raises
    ------
    FileNotFoundError
        If the folder doesn't exist.
    """
    target = Path(path).absolute()
    if not target.parent.is_dir():
        raise FileNotFoundError(f"The folder {target.parent} does not exist; create it, or give another file name.")
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(8)}.tmp")
    try:
        yield temporary
        _flush_to_disk(temporary)
        temporary.replace(target)
        _flush_to_disk(target.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _flush_to_disk(path: Path) -> None:
    if os.name == "nt" and path.is_dir():
        return  # Windows opens no folders
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)  # and flushes only what it may write
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
