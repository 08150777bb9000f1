"""Files that are written completely or not at all, and never replace a database; file systems of paths."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

from calcidem.input_file import open_input
from calcidem.storage.errors import OutputRefusedError

BESIDE_A_DATABASE = ("-wal", "-shm", "-journal")
"""Endings of SQLite's files beside a database."""


@contextmanager
def write_atomically(path: str | os.PathLike[str], *, replaces_netcdf: bool = False) -> Iterator[Path]:
    """Yield a temporary file that replaces `path` once the block has ended without error and the file is on disk.

    It is in the folder of `path`, since only within a file system a file is renamed in one step. Its name is unique.
    After an error `path` is unchanged. Set ``replaces_netcdf`` if the NetCDF file at `path` may be replaced.
    `FileNotFoundError` if the folder does not exist; `OutputRefusedError` if `path` is a database or a NetCDF file.
    """
    refuse_to_replace(path, replaces_netcdf=replaces_netcdf)
    with replace_file(Path(path).resolve()) as temporary:
        yield temporary


@contextmanager
def replace_file(target: Path) -> Iterator[Path]:
    """Yield a temporary file for `write_atomically`, which replaces any file."""
    kept_name = os.fsdecode(os.fsencode(target.name)[:180])  # file systems allow 255 bytes, and SQLite adds endings
    temporary = target.with_name(f".{kept_name}.{secrets.token_hex(8)}.tmp")
    try:
        yield temporary
        flush_to_disk(temporary)
        with suppress(FileNotFoundError):
            shutil.copymode(target, temporary)
        temporary.replace(target)
        flush_to_disk(target.parent)
    finally:
        for end in ("", *BESIDE_A_DATABASE):
            Path(f"{temporary}{end}").unlink(missing_ok=True)


def write_text_atomically(path: str | os.PathLike[str], text: str) -> None:
    """Write a text in UTF-8 as `write_atomically` does, with unchanged line ends."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")


def refuse_to_replace(path: str | os.PathLike[str], *, replaces_netcdf: bool = False) -> None:
    """Raise the errors of `write_atomically` early, before a long computation."""
    target = Path(path).resolve()  # the file of a link, as a program that opens it would write it
    if not target.parent.is_dir():
        raise FileNotFoundError(f"The folder {target.parent} does not exist; create it, or give another file name.")
    what = "is a folder or a device" if target.exists() and not target.is_file() else ""
    for end in (*BESIDE_A_DATABASE, ".lock", ""):
        database = target.with_name(target.name.removesuffix(end)) if target.name.endswith(end) else target
        if beginning(database).startswith(b"SQLite format 3\0"):
            what = "is a database" if database == target else f"belongs to the database {database}"
    begins = beginning(target)
    if not replaces_netcdf and begins.startswith(b"\x89HDF\r\n\x1a\n"):
        what = "is a NetCDF file"
    if replaces_netcdf and not what and begins and not begins.startswith((b"\x89HDF\r\n\x1a\n", b"CDF")):
        what = "is no NetCDF file"
    if what:
        raise OutputRefusedError(f"{target} {what}.", "Give another file name for the result; nothing was written.")


def beginning(path: Path) -> bytes:
    """First 20 bytes of a file; empty if it does not exist or is not a file."""
    if not path.is_file():
        return b""
    with open_input(path) as file:
        return file.read(20)


def flush_to_disk(path: Path) -> None:
    """Return once a file or the names in a folder are on disk; `OSError` if they cannot be."""
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
    begin_a_formula = (*"=+-@\t\r\n", "\N{FULLWIDTH EQUALS SIGN}", "\N{FULLWIDTH COMMERCIAL AT}")
    if not isinstance(value, str) or not value.startswith(begin_a_formula):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def filesystem_type(path: Path, mountinfo: str | None = None) -> str | None:
    """Type of the file system of a path, such as ``"ext4"``; None if unknown (no /proc).

    The path need not exist yet. ``mountinfo`` is a text in the format of ``/proc/self/mountinfo`` (proc(5)), by default
    this file.
    """
    if mountinfo is None:
        try:
            mountinfo = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="surrogateescape")
        except OSError:
            return None
    resolved = path.resolve()
    found: tuple[int, str] | None = None
    for line in mountinfo.splitlines():
        before, separator, after = line.partition(" - ")
        fields = before.split()
        if not separator or len(fields) < 5:  # the mount point is the fifth field
            continue
        for code, character in (("\\040", " "), ("\\011", "\t"), ("\\012", "\n"), ("\\134", "\\")):
            fields[4] = fields[4].replace(code, character)
        depth = len(Path(fields[4]).parts)
        # A later mount on the same point hides the earlier one, hence >=.
        if resolved.is_relative_to(fields[4]) and (found is None or depth >= found[0]):
            found = (depth, after.split()[0])
    return found[1] if found else None


def is_network_filesystem(path: Path, mountinfo: str | None = None) -> bool:
    """Whether a path is on a network or cluster file system, on which SQLite's write-ahead log does not work.

    Every ``fuse.*`` type counts as one (sshfs, glusterfs, s3fs ...): a wrong yes costs speed, a wrong no costs data.
    """
    kind = filesystem_type(path, mountinfo) or ""
    networks = (
        "9p acfs afs beegfs ceph cifs gfs gfs2 gpfs lustre ncpfs nfs nfs4 ocfs2 orangefs panfs pvfs2 smb3 smbfs "
        "virtiofs wekafs"
    )
    return kind.startswith("fuse.") or kind in networks.split()


def can_lock(folder: Path) -> bool:
    """Whether the file system of a folder has the locks that SQLite uses; True if that is unknown."""
    with suppress(ImportError, OSError), TemporaryFile(dir=folder) as file:
        import fcntl  # noqa: PLC0415 - not on Windows

        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
    return True
