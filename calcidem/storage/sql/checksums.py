"""Checksums of rows, which detect changes of stored data.

Each row has a checksum of its columns and, if it belongs to a cell, of the cell's seed and content. An outcome has a
second checksum of status, velocities and their errors, so that queries of velocities need not read the others. A
checksum detects damage; it does not protect against deliberate changes.

A value becomes a word of 64 bits: a number its own bits, any other value its hash. The name of the column is added, and
the bits are mixed. The words of a row are summed and mixed again. Missing values add nothing, so a new column of a
table does not change checksums. Mixing is reversible, so the change of one value always changes the sum.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import cache, lru_cache
from hashlib import blake2b
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Double, Table

from calcidem.storage.records import CellKey
from calcidem.storage.sql.tables import BRIEF_QUANTITIES, RESULT

_NOT_COVERED = {"id", "campaign_id", "cell_id", "forgiven", "checksum"}
"""Excluded columns: row numbers of the database, and the flag of attempts before a retry, which changes."""

_WORD = 2**64
_NOTHING = -(2**63)  # stands for a missing whole number until its word is removed


def row_checksums(table: Table, columns: Mapping[str, Sequence[Any]]) -> list[int]:
    """Return the checksums of some rows from their values by column, and `seed` and `content` of their cells.

    A row that belongs to another cell is therefore damaged.
    """
    length = len(next(iter(columns.values())))
    total = np.zeros(length, dtype=np.uint64)
    for name, values in columns.items():
        words, is_there = _column_words(values, is_real=name == "content" or _is_real(table, name))
        total += np.where(is_there, _mix(words + _salt(table.name, name)), np.uint64(0))
    checksums: list[int] = _mix(total).view(np.int64).tolist()
    return checksums


def seal(
    table: Table, rows: Sequence[dict[str, Any]], keys: Sequence[CellKey] | None = None
) -> Sequence[dict[str, Any]]:
    """Add checksums to rows before they are stored; `keys` are those of their cells."""
    if not rows:
        return rows
    columns: dict[str, Sequence[Any]] = {name: [row.get(name) for row in rows] for name in covered_columns(table)}
    if keys is not None:
        columns |= {"seed": [key.seed for key in keys], "content": [key.content for key in keys]}
    if table is RESULT:
        columns["brief_checksum"] = row_checksums(
            table, {name: columns[name] for name in ("seed", "content", *BRIEF_QUANTITIES)}
        )
        for row, checksum in zip(rows, columns["brief_checksum"], strict=True):
            row["brief_checksum"] = checksum
    for row, checksum in zip(rows, row_checksums(table, columns), strict=True):
        row["checksum"] = checksum
    return rows


def is_intact(table: Table, row: Mapping[str, Any]) -> bool:
    """Whether a row without a cell is unchanged."""
    return [row["checksum"]] == row_checksums(table, {name: [row[name]] for name in covered_columns(table)})


def arrays_text(arrays: Mapping[str, bytes]) -> str:
    """Return names and checksums of the arrays beside an outcome."""
    return " ".join(f"{name}:{blake2b(arrays[name], digest_size=8).hexdigest()}" for name in sorted(arrays))


@cache
def covered_columns(table: Table) -> tuple[str, ...]:
    """Return the columns that the checksum of a row covers."""
    return tuple(column.name for column in table.columns if column.name not in _NOT_COVERED)


@cache
def _is_real(table: Table, name: str) -> bool:
    return name in table.c and isinstance(table.c[name].type, Double)


@cache
def _salt(table: str, column: str) -> np.uint64:
    return np.uint64(_hash_of(f"{table}.{column}".encode()))


def _mix(words: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Spread each bit over all 64 (the last step of SplitMix64, doi:10.1145/2714064.2660195)."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


def _column_words(values: Sequence[Any], *, is_real: bool) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """Words of the values of a column, and flags of existing values."""
    types = set(map(type, values))
    if is_real and types <= {float, int, NoneType}:
        real = np.array(values, dtype=np.float64) + 0.0  # not every database keeps the sign of zero
        return real.view(np.uint64), ~np.isnan(real)
    if not is_real and types <= {int, NoneType}:
        whole = np.array([_NOTHING if value is None else value for value in values], dtype=np.int64)
        return whole.view(np.uint64), whole != _NOTHING
    if types <= {str, datetime, NoneType}:
        known = {value: 0 if value is None else _word(value) for value in set(values)}  # cached: most are the same
        words = [known[value] for value in values]
    else:
        words = [
            0 if value is None else _word(float(value) if is_real and type(value) is int else value) for value in values
        ]
    return np.array(words, dtype=np.uint64), np.array([value is not None for value in values])


def _word(value: object) -> int:
    """Word of a value of any type, as for a whole column."""
    if isinstance(value, str):
        return _word_of_text(str(value))
    if isinstance(value, float):
        (word,) = struct.unpack("<Q", struct.pack("<d", value + 0.0))
        return int(word)
    if isinstance(value, int):
        return value % _WORD
    if isinstance(value, datetime):
        return _word_of_text(value.astimezone(UTC).isoformat())
    return _hash_of(value if isinstance(value, bytes) else json.dumps(value, sort_keys=True).encode())


@lru_cache(4096)  # cached, since most outcomes, hosts and reasons are the same
def _word_of_text(text: str) -> int:
    return _hash_of(text.encode("utf-8", "surrogatepass"))


def _hash_of(content: bytes) -> int:
    return int.from_bytes(blake2b(content, digest_size=8).digest(), "little")
