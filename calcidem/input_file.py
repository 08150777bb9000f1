"""The one door for what a user names: regular files of limited size, also unpacked; a refusal says cause and remedy."""

import gzip
import io
import os
import stat
import zipfile
import zlib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

MOST_BYTES = 1_000_000_000
"""Limit for arrays: those of the 10 million disks that a configuration may have take 0.7 GB."""


class InputFileError(ValueError):
    """A file that cannot be used as input; the message has its name, the cause and the remedy."""


@contextmanager
def open_input(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file for reading; nothing waits, for a pipe without a writer for instance.

    `InputFileError` for other kinds of files, and for errors of the system while the file is open.
    """
    without_waiting = getattr(os, "O_NONBLOCK", 0)  # Windows has none
    try:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | without_waiting)) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InputFileError(f"{path} is a pipe or a device; give the name of a file")
            yield file
    except IsADirectoryError as error:
        raise InputFileError(f"{path} is a folder; give the name of a file") from error
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputFileError(f"{path} can't be read ({reason}); check its name and permissions") from error


def read_input(path: Path, limit: int) -> bytes:
    """Content of a file, unpacked if it is compressed with gzip; of at most `limit` bytes, and no more is read.

    `InputFileError` for a larger or damaged file, and as `open_input`.
    """
    too_large = InputFileError(f"{path} has more than {limit / 1e6:g} MB; check the name, or leave something out")
    with open_input(path) as file:
        if os.fstat(file.fileno()).st_size > limit:
            raise too_large
        content = file.read(limit + 1) or b""  # files of the kernel state no size, and None if they have nothing now
    if len(content) > limit:
        raise too_large
    if content.startswith(b"\x1f\x8b"):
        try:
            content = gzip.GzipFile(fileobj=io.BytesIO(content)).read(limit + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise InputFileError(f"{path} is damaged and can't be unpacked ({error}); copy or make it again") from error
    if len(content) > limit:
        raise too_large
    return content


def read_text(path: Path, limit: int, fallback: str = "") -> str:
    """Text of a file as `read_input`, in UTF-8 or, with a byte order mark, UTF-16; lines end with one character.

    Other text is taken to be in the encoding ``fallback``, if there is one.
    """
    return as_text(read_input(path, limit), path, fallback)


def as_text(content: bytes, path: Path, fallback: str = "") -> str:
    """Decode the content of a file as `read_text` does."""
    encoding = "utf-16" if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        if not fallback:
            cause = f"byte {error.start + 1} is not {error.encoding.upper()}, perhaps Latin-1"
            raise InputFileError(f"{path} is not text ({cause}); save the file as UTF-8") from error
        text = content.decode(fallback, "replace")
    if "\0" in text:
        raise InputFileError(f"{path} is not text (it has zero bytes); check the name, or save the file as UTF-8")
    return text.replace("\r\n", "\n")


def zip_members(content: bytes, limit: int = MOST_BYTES) -> dict[str, bytes]:
    """Members of a zip or npz archive by name; together of at most `limit` bytes, whatever the archive states.

    `InputFileError` for a larger or damaged archive.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if total > limit or {member.compress_type for member in members} - {
                zipfile.ZIP_STORED,
                zipfile.ZIP_DEFLATED,
            }:
                raise InputFileError(f"the archive unpacks to {total / 1e6:g} MB, or is packed in an unknown way")
            found = {}
            for member in members:
                with archive.open(member) as file:  # without the size, all is unpacked before it is compared
                    found[member.filename] = file.read(member.file_size)
            return found
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError) as error:
        raise InputFileError(f"the archive is damaged ({error})") from error
