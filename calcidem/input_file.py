"""The one door for files that a user names, regular and of limited size, also unpacked; the one reader of tables.

Tables may have any separator, decimal commas, comments, encodings, and units in names or at numbers. A refusal says
cause and remedy.
"""

import csv
import gzip
import io
import math
import os
import re
import stat
import unicodedata
import zipfile
import zlib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
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


def as_text(content: bytes, path: Path, fallback: str = "") -> str:
    """Text of the content of a file, in UTF-8 or, with a byte order mark, UTF-16; lines end with one character.

    Other text is taken to be in the encoding ``fallback``, if there is one.
    """
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


def zip_members(content: bytes) -> dict[str, bytes]:
    """Members of a zip or npz archive by name; together of at most `MOST_BYTES`, whatever the archive states.

    `InputFileError` for a larger or damaged archive.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if total > MOST_BYTES or {member.compress_type for member in members} - {
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


UNITS = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
    "velocity": {"m/s": 1.0, "km/s": 1e3},
    "stress": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "bar": 1e5},
    "density": {"kg/m3": 1.0, "g/cm3": 1e3, "t/m3": 1e3, "Mg/m3": 1e3},
    "percent": {"%": 1.0, "percent": 1.0, "wt%": 1.0, "-": 100.0},
}
"""Factors to SI units, and to percent, by the quantity that has them."""


_MARKS = ("\t", ";", "|", ",", "")
"""Delimiters of columns; the empty one is white space."""


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of a table and the names of its columns."""

    names: tuple[str, ...]
    """From the left; empty without a line of names."""
    head: int
    """Line of the names; 0 without."""
    rows: list[tuple[int, list[str]]]
    """Line and entries of each row; decimal commas are points."""

    @staticmethod
    def read(content: bytes, path: Path, known: Mapping[str, str], least: Sequence[str], numbers: int = 2) -> "Table":
        """Read a table from the content of a file, in UTF-8, UTF-16 or the Western European encoding of Windows.

        ``known`` is the pattern of names of each quantity, see `meaning_of`. A line with those of ``least`` names the
        columns; otherwise the line above the first row does. The first row is the first line with so many ``numbers``.
        Lines that begin with # or % are comments, and those with ; unless it separates columns. `InputFileError`
        if this is not text, or names and rows do not match.
        """
        lines = as_text(content, path, fallback="cp1252").splitlines()
        plain = (n for n, line in enumerate(lines) if not line.lstrip().startswith(("#", "%")))
        first = next((n for n in plain if _numbers(split(lines[n])) >= numbers), len(lines))
        row = lines[first] if first < len(lines) else ""
        delimiter, count, head, names = _delimiter(row), len(split(row)), -1, list[str]()
        for mark in (delimiter,) if row else _MARKS:
            for n in range(first - 1, -1, -1):
                found = _names(lines[n], mark, count)
                if n > head and set(least) <= {meaning_of(name, known) for name in found}:
                    delimiter, head, names = mark, n, found
        if head < 0 and row and (above := [n for n in range(first) if re.search(r"\w", lines[n])]):
            found = _names(lines[above[-1]], delimiter, count)
            if len(found) == count and lines[above[-1]].lstrip()[0] not in "#%;":
                head, names = above[-1], found
        if names and row and not delimiter and len(names) != count:
            raise InputFileError(
                f"{path}: line {head + 1} names {len(names)} columns, and line {first + 1} has {count} entries; "
                "separate the columns by tabs, semicolons or commas, or write names without blanks"
            )
        comments = ("#", "%") if delimiter == ";" else ("#", "%", ";")
        start = head + 1 if names else first
        for n, line in enumerate(lines[start:], start + 1) if delimiter == "," else ():
            if doubtful := re.search(r'"\s*[-+]?([1-9]\d{0,2}(?:,\d{3})+)(?![\d,])', line):
                cure = "write numbers without marks of thousands, and with a point for decimals"
                raise InputFileError(f"{path}, line {n}: {doubtful[1]} may be a whole number or a fraction; {cure}")
        rows = [
            (n, split(line, delimiter))
            for n, line in enumerate(islice(lines, start, None), start + 1)
            # A line of units may begin with %.
            if (re.search(r"\w", line) and not line.lstrip().startswith(comments))
            or (names and n <= first and all(map(_dimension, split(line, delimiter))))
        ]
        if names and rows and rows[0][0] <= first and all(not unit or _dimension(unit) for unit in rows[0][1]):
            units = rows.pop(0)[1]  # a line of units below that of names
            names = [f"{name} ({unit})" if unit else name for name, unit in zip(names, units, strict=False)]
        return Table(tuple(names), head + 1, rows)

    def places(self, known: Mapping[str, str]) -> dict[str, int]:
        """Column of each quantity, the first of several; see `meaning_of`."""
        found: dict[str, int] = {}
        for place, name in enumerate(self.names):
            found.setdefault(meaning_of(name, known), place)
        return found


def split(line: str, delimiter: str | None = None) -> list[str]:
    """Entries of a line, with points for decimal commas; by default with the delimiter that gives most numbers.

    An empty delimiter is white space; then a vector in brackets gives several entries.
    """
    delimiter = _delimiter(line) if delimiter is None else delimiter
    if not delimiter:
        line = re.sub(r"(?<=\d),(?=\d)", " " if "(" in line else ".", line)
        return re.sub(r"[()\[\],]", " ", line).split()
    try:
        words = [word.strip() for word in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:  # a text longer than any entry
        words = [line]
    return [re.sub(r"(?<=\d),(?=\d)", ".", word) if "," in word else word for word in words]


def _delimiter(line: str) -> str:
    """Delimiter of the entries of a line; empty for white space."""
    if "(" in line:
        return ""
    return max(_MARKS, key=lambda mark: 2 * _numbers(words := split(line, mark)) - sum(map(bool, words)))


def _names(line: str, delimiter: str, count: int) -> list[str]:
    """Names of the columns in a line; of a vector those of its components, if rows have ``count`` entries."""
    line = line.strip().lstrip("#;%" if delimiter != ";" else "#%").strip()
    if delimiter:
        return split(line, delimiter)
    line = re.sub(r"\b(pos\w*|coord\w*|cent\w*)[\s.:-]+([xyz])\b", r"\1\2", line, flags=re.IGNORECASE)
    line = re.sub(r"\s+([\[(]\s*[^\s\])]+\s*[\])])", r"\1", line)  # a unit belongs to the preceding name
    line = re.sub(r"\bball\s+(id|radius)\b", r"\1", line, flags=re.IGNORECASE)
    names: list[str] = []
    words = line.replace(",", " ").split()
    for word in words:
        is_vector = word.lower() in {"pos", "position", "centroid"}
        names += ("x", "y", "z")[: 1 + count - len(words)] if is_vector else (word,)
    return names


def _numbers(words: Sequence[str]) -> int:
    """How many entries are numbers, perhaps with a unit."""
    parts = map(parse_number, words)
    return sum(found is not None and (not found[1] or bool(_dimension(found[1]))) for found in parts)


def parse_number(text: str) -> tuple[float, str] | None:
    """Number at the beginning of a text, and the rest without blanks around; None without a number."""
    found = re.fullmatch(
        r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|[-+]?(?:nan|inf))\s*(.*?)\s*", text, re.IGNORECASE | re.ASCII
    )
    return None if found is None else (float(found[1]), found[2])


def value_of(text: str, dimension: str, unit: str | None) -> float:
    """Value of an entry in SI units, or in percent; its unit is that at the number, or else ``unit``.

    NaN if it is no number, or has no unit of the dimension (a key of `UNITS`).
    """
    found = parse_number(text)
    factor = math.nan if found is None else factor_of(found[1] or unit or "", dimension)
    if found is None or math.isnan(factor):
        return math.nan
    return found[0] if factor == 1.0 else float(f"{found[0] * factor:.12g}")  # 0.0003, not 0.00030000000000000003


def factor_of(unit: str, dimension: str) -> float:
    """Factor of a unit to SI units or percent; NaN if it is none of the dimension."""
    plain = unicodedata.normalize("NFKC", unit).replace("\u03bc", "u").replace("\N{MINUS SIGN}", "-")
    plain = re.sub(r"[\s\u00b7*^()\[\]{}]", "", plain).lower()
    plain = re.sub(r"(cm|m|s)-([13])$", lambda found: f"/{found[1]}{found[2].strip('1')}", plain)  # m s-1
    return next((factor for name, factor in UNITS[dimension].items() if name.lower() == plain), math.nan)


def _dimension(unit: str) -> str:
    """Dimension of a unit; empty for another text."""
    return next((dimension for dimension in UNITS if not math.isnan(factor_of(unit, dimension))), "")


def unit_in_name(name: str, dimension: str = "") -> tuple[str, str]:
    """Name of a column without its unit, and the unit, such as in ``x_mm``, ``Vs (m/s)`` or ``d in µm``.

    Only of a dimension, if one is given; `InputFileError` for a unit of another one, and for unknown marks in brackets.
    """
    for found in re.finditer(r"\s+in\s+|\s*[\[({_/,]\s*|\s+", name):
        before, unit = name[: found.start()], name[found.end() :].rstrip(" ])}")
        if before and (_dimension(unit) if not dimension else not math.isnan(factor_of(unit, dimension))):
            return before, unit
    marks = re.search(r"[\[({]\s*([^\w\s\[\](){}]+)\s*[\])}]", name)
    if dimension and (wrong := unit_in_name(name)[1] or (marks or ("", ""))[1]):
        cure = f"give one of {', '.join(UNITS[dimension])}"
        raise InputFileError(f"column '{name}': its unit '{wrong}' is not one of this quantity; {cure}")
    return name, ""


def meaning_of(name: str, known: Mapping[str, str]) -> str:
    """Quantity whose pattern the whole name matches, without its unit, marks and capitals; empty without one."""
    plain = re.sub(r"[^a-z0-9]", "", unicodedata.normalize("NFKD", unit_in_name(name)[0]).casefold())  # ß: ss
    return next((quantity for quantity, pattern in known.items() if re.fullmatch(pattern, plain)), "")
