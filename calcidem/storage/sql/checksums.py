"""Checksums of rows: what was changed since it was stored is not taken for what was computed.

Each row has the checksum of its own columns and of what it belongs to. The row of an outcome has those of its arrays,
too, so that one that is missing is noticed, and damaged arrays are, without the rest being read. A checksum finds
damage; it does not protect from somebody who wants to change a number.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from hashlib import blake2b
from typing import Any

from sqlalchemy import Double, Table

_NOT_COVERED = {"id", "campaign_id", "cell_id", "forgiven", "checksum"}
"""Numbers that are the database's own, and what changes: whether an attempt was forgiven."""


def _plain(value: object) -> object:
    """What stands for bytes and moments in the text that a checksum is of."""
    if isinstance(value, bytes):
        return blake2b(value, digest_size=16).hexdigest()
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat()
    raise TypeError(f"{type(value).__name__} is no type of a column")


_encode = json.JSONEncoder(default=_plain, sort_keys=True, separators=(",", ":")).encode


def _row_checksum(table: Table, owner: Sequence[object], values: Iterable[object]) -> str:
    """Return the checksum of a row, 16 hexadecimal digits.

    Parameters
    ----------
    table : Table
    owner : sequence
        What the row belongs to, such as seed and content: a row that turns up at another cell is damaged.
    values : iterable
        In the order of `covered_columns`.
    """
    # Not every database keeps the sign of a zero. What is missing is left out, so that a column that is added to the
    # table leaves the checksums of its rows as they are.
    named = zip(covered_columns(table), values, strict=True)
    plain = {name: value + 0.0 if type(value) is float else value for name, value in named if value is not None}
    return blake2b(_encode([table.name, *owner, plain]).encode(), digest_size=8).hexdigest()


@cache
def covered_columns(table: Table) -> tuple[str, ...]:
    """Return the columns that a row's checksum is of."""
    return tuple(column.name for column in table.columns if column.name not in _NOT_COVERED)


@cache
def _real_columns(table: Table) -> frozenset[str]:
    return frozenset(column.name for column in table.columns if isinstance(column.type, Double))


def checksum_of(table: Table, owner: Sequence[object], columns: Mapping[Any, Any]) -> str:
    """Return the checksum of a row that is about to be stored: whole numbers in real columns come back as real ones."""
    real = _real_columns(table)
    found = ((name, columns.get(name)) for name in covered_columns(table))
    values = [float(value) if isinstance(value, int) and name in real else value for name, value in found]
    return _row_checksum(table, owner, values)


def is_intact(table: Table, owner: Sequence[object], values: Iterable[object], checksum: object) -> bool:
    """Whether a row is what was stored; `values` as for `_row_checksum`, `checksum` as the row has it."""
    return checksum == _row_checksum(table, owner, values)


def arrays_text(arrays: Mapping[str, bytes]) -> str:
    """Return names and checksums of the arrays beside an outcome."""
    return " ".join(f"{name}:{blake2b(arrays[name], digest_size=8).hexdigest()}" for name in sorted(arrays))
