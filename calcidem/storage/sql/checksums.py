"""Checksums of rows: what was changed since it was stored is not taken for what was computed.

Each row has the checksum of its own columns and of what it belongs to. The row of an outcome has those of the rows
beside it, too (path, graph, signal, cement), so that one that is missing is noticed, and damaged arrays are, without
the rest being read. A checksum finds damage; it does not protect from somebody who wants to change a number.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from hashlib import blake2b
from typing import Any

from sqlalchemy import Double

from calcidem.storage.sql.models import (
    Base,
    CementRow,
    GraphRow,
    PathRow,
    ResultRow,
    SignalRow,
)

PARTS: tuple[type[Base], ...] = (PathRow, GraphRow, SignalRow, CementRow)
"""Tables with the rows that may be beside an outcome."""

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


def _row_checksum(model: type[Base], owner: Sequence[object], values: Iterable[object]) -> str:
    """Return the checksum of a row, 16 hexadecimal digits.

    Parameters
    ----------
    model : type
    owner : sequence
        What the row belongs to, such as seed and content: a row that turns up at another cell is damaged.
    values : iterable
        In the order of `covered_columns`.
    """
    # Not every database keeps the sign of a zero. What is missing is left out, so that a column that is added to the
    # table leaves the checksums of its rows as they are.
    named = zip(covered_columns(model), values, strict=True)
    plain = {name: value + 0.0 if type(value) is float else value for name, value in named if value is not None}
    return blake2b(_encode([model.__tablename__, *owner, plain]).encode(), digest_size=8).hexdigest()


@cache
def covered_columns(model: type[Base]) -> tuple[str, ...]:
    """Return the columns that a row's checksum is of."""
    return tuple(column.name for column in model.__table__.columns if column.name not in _NOT_COVERED)


@cache
def _real_columns(model: type[Base]) -> frozenset[str]:
    return frozenset(column.name for column in model.__table__.columns if isinstance(column.type, Double))


def checksum_of(model: type[Base], owner: Sequence[object], columns: Mapping[Any, Any]) -> str:
    """Return the checksum of a row that is about to be stored: whole numbers in real columns come back as real ones."""
    real = _real_columns(model)
    found = ((name, columns.get(name)) for name in covered_columns(model))
    values = [float(value) if isinstance(value, int) and name in real else value for name, value in found]
    return _row_checksum(model, owner, values)


def parts_text(owner: Sequence[object], columns: Mapping[str, Mapping[Any, Any]]) -> str:
    """Return names and checksums of the rows beside an outcome, from their columns by table."""
    return " ".join(
        f"{model.__tablename__}:{checksum_of(model, owner, columns[model.__tablename__])}"
        for model in PARTS
        if model.__tablename__ in columns
    )


def result_checksum(owner: Sequence[object], columns: Mapping[Any, Any], parts: str) -> str:
    """Return what the row of an outcome has as checksum: its own, which covers `parts_text`, and that."""
    return f"{checksum_of(ResultRow, (*owner, parts), columns)} {parts}".rstrip()


def is_intact(model: type[Base], owner: Sequence[object], values: Iterable[object], checksum: object) -> bool:
    """Whether a row is what was stored; `values` as for `_row_checksum`, `checksum` as the row has it."""
    if not isinstance(checksum, str):
        return False
    own, _, parts = checksum.partition(" ")
    return own == _row_checksum(model, (*owner, parts) if model is ResultRow else owner, values)


def is_intact_part(model: type[Base], owner: Sequence[object], values: Sequence[object] | None, checksum: str) -> bool:
    """Whether the row beside an outcome is what was stored; None if there is no such row.

    Parameters
    ----------
    model : type
        Of `PARTS`.
    owner, values
        As for `_row_checksum`.
    checksum : str
        Of the outcome, which is intact.
    """
    words = checksum.split(" ")[1:]
    expected = dict(word.split(":") for word in words).get(model.__tablename__)
    return expected == (None if values is None else _row_checksum(model, owner, values))
