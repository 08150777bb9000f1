"""Removal of session folders and shared memory that killed processes of Open MPI leave on a host."""

import os
import re
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - where Open MPI has it, whatever TMPDIR says

_SETTLED = 60.0
"""Age in seconds above which an unused file belongs to no starting process."""


def remove_leftovers() -> None:
    """Remove files of killed launches of this user from this host; files that may be in use are kept.

    A session folder is removed if the mpirun of its number ran on this host and has ended; containers may share the
    folder. A segment of shared memory is removed if no process maps it.
    """
    host, user = socket.gethostname(), os.getuid()
    for folder in _settled(Path(tempfile.gettempdir()), "ompi.*", user):
        process = folder.name.rpartition(".")[2]
        if (
            process.isdigit()
            and (folder / f"pmix.{host}.tool.{process}").exists()
            and not Path("/proc", process).exists()
        ):
            shutil.rmtree(folder, ignore_errors=True)
    segments = list(_settled(_SHARED_MEMORY, f"sm_segment.{host}.{user}.*", user))
    mapped = _mapped_files() if segments else set()
    for segment in segments:
        if str(segment) not in mapped:
            with suppress(OSError):
                segment.unlink()


def _settled(folder: Path, pattern: str, user: int) -> Iterator[Path]:
    """Files of a user in a folder that are older than a limit."""
    for path in folder.glob(pattern):
        with suppress(OSError):
            found = path.lstat()
            if found.st_uid == user and not path.is_symlink() and time.time() - found.st_mtime > _SETTLED:
                yield path


def _mapped_files() -> set[str]:
    """Names of all files in shared memory that processes of this user map."""
    found: set[str] = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):
            found |= set(re.findall(rf"{_SHARED_MEMORY}/\S+", maps.read_text(encoding="utf-8", errors="replace")))
    return found
