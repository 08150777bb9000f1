"""Checksums of rows: what was changed since it was stored is not taken for what was computed.

Each row has a checksum of its columns and, if it belongs to a cell, of the cell's seed and content. An outcome has a
second one of its few brief quantities, so that a question about velocities alone does not read the others. A checksum
finds damage; it does not protect against deliberate changes.

A value is a word of 64 bits: a number as it is, anything else by its hash. The name of its column is added, the bits
are mixed, and the words of a row are summed up and mixed again. What is missing adds nothing, so a column that is added
to a table leaves its checksums as they are. A change of one value always changes the sum, since mixing is reversible.
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
"""Numbers that are the database's own, and what changes: whether an attempt was forgiven."""

_WORD = 2**64
_NOTHING = -(2**63)  # stands for a missing whole number until its word is left out


def row_checksums(table: Table, columns: Mapping[str, Sequence[Any]]) -> list[int]:
    """Return the checksums of some rows from their values by column, and `seed` and `content` of their cells.

    So a row that turns up at another cell is damaged.
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
    """Give rows that are about to be stored their checksums; `keys` are those of their cells."""
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
    """Whether a row that belongs to no cell is what was stored."""
    return [row["checksum"]] == row_checksums(table, {name: [row[name]] for name in covered_columns(table)})


def arrays_text(arrays: Mapping[str, bytes]) -> str:
    """Return names and checksums of the arrays beside an outcome."""
    return " ".join(f"{name}:{blake2b(arrays[name], digest_size=8).hexdigest()}" for name in sorted(arrays))


@cache
def covered_columns(table: Table) -> tuple[str, ...]:
    """Return the columns that a row's checksum is of."""
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
    """Words of the values of a column, and where there are any."""
    types = set(map(type, values))
    if is_real and types <= {float, int, NoneType}:
        real = np.array(values, dtype=np.float64) + 0.0  # not every database keeps the sign of a zero
        return real.view(np.uint64), ~np.isnan(real)
    if not is_real and types <= {int, NoneType}:
        whole = np.array([_NOTHING if value is None else value for value in values], dtype=np.int64)
        return whole.view(np.uint64), whole != _NOTHING
    if types <= {str, datetime, NoneType}:
        known = {value: 0 if value is None else _word(value) for value in set(values)}  # much the same ones
        words = [known[value] for value in values]
    else:
        words = [
            0 if value is None else _word(float(value) if is_real and type(value) is int else value) for value in values
        ]
    return np.array(words, dtype=np.uint64), np.array([value is not None for value in values])


def _word(value: object) -> int:
    """Word of a value of any type, the same as that of a whole column."""
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


@lru_cache(4096)  # outcomes, hosts and reasons are much the same
def _word_of_text(text: str) -> int:
    return _hash_of(text.encode("utf-8", "surrogatepass"))


def _hash_of(content: bytes) -> int:
    return int.from_bytes(blake2b(content, digest_size=8).digest(), "little")
