"""Selections and summaries of a store, without the database."""

import os
import socket
from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from types import TracebackType
from typing import Self

from calcidem.storage.errors import QueryError
from calcidem.storage.records import (
    CellKey,
    CellStatus,
    canonical_content,
    checked_seed,
)

RETRIED_BY_DEFAULT = (CellStatus.FAILED, CellStatus.TIMED_OUT)

STALE_AFTER = timedelta(minutes=5)
"""A master on another machine without a heartbeat for this long counts as dead."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The cells of a query; None means no restriction.

    Attributes
    ----------
    seeds : tuple of int, optional
        Given as one or a collection, as are the others.
    contents : tuple of float, optional
        Percent; compared as `canonical_content`.
    statuses : tuple of CellStatus, optional
        May include `CellStatus.PENDING` for planned cells without an outcome.
    where : str, optional
        Filter expression (`calcidem.storage.sql.where.parse_where`).
    since : datetime, optional
        Only cells of which an attempt was recorded at this moment or later.

    Raises
    ------
    QueryError
        For an unknown status.
    """

    seeds: tuple[int, ...] | None
    contents: tuple[float, ...] | None
    statuses: tuple[CellStatus, ...] | None
    where: str | None
    since: datetime | None

    def __init__(
        self,
        seeds: int | Collection[int] | None = None,
        contents: float | Collection[float] | None = None,
        statuses: str | Collection[str] | None = None,
        where: str | None = None,
        since: datetime | None = None,
    ) -> None:
        seeds = seeds if isinstance(seeds, Collection) or seeds is None else (seeds,)
        contents = contents if isinstance(contents, Collection) or contents is None else (contents,)
        statuses = (statuses,) if isinstance(statuses, str) else statuses
        if unknown := set(statuses or ()) - set(CellStatus):
            raise QueryError(f"status = '{min(unknown)}' is none.", f"Give one of {', '.join(CellStatus)}.")
        normal: dict[str, object] = {
            "seeds": None if seeds is None else tuple(sorted(set(map(checked_seed, seeds)))),
            "contents": None if contents is None else tuple(sorted(set(map(canonical_content, contents)))),
            "statuses": None if statuses is None else tuple(map(CellStatus, statuses)),
            "where": where,
            "since": since,
        }
        for name, value in normal.items():
            object.__setattr__(self, name, value)


ALL_CELLS = Selection()


@dataclass(frozen=True, slots=True)
class StoreMark:
    """Numbers of a whole database, one of which changes with any change of a cell.

    Attributes
    ----------
    cells, attempts, results : int
        How many are planned, were made, and are stored.
    recorded : datetime or None
        When the latest attempt was recorded (UTC).
    """

    cells: int
    attempts: int
    results: int
    recorded: datetime | None


@dataclass(frozen=True, slots=True)
class LeaseGrant:
    """The right to write a campaign.

    Attributes
    ----------
    token : str
        Identity of this master.
    taken_over_from : str or None
        ``host, process N, last heartbeat at T`` of a dead master whose lease this one took over; to be
        reported.
    lost : str or None
        A sentence on stored cells of the dead master that are missing; to be reported.
    """

    token: str
    taken_over_from: str | None
    lost: str | None = None


@dataclass(frozen=True, slots=True)
class LeaseHolder:
    """The process that holds the lease of a campaign, or held it when it died.

    Attributes
    ----------
    host : str
    pid : int
        Its number there.
    acquired : datetime
        When it became the master (UTC).
    heartbeat : datetime
        Time of its last heartbeat (UTC).
    """

    host: str
    pid: int
    acquired: datetime
    heartbeat: datetime

    def may_live(self) -> bool:
        """Whether it may be alive, as far as this machine shows: on another one its heartbeat decides."""
        if datetime.now(UTC) - self.heartbeat > STALE_AFTER:
            return False
        if self.host != socket.gethostname():
            return True
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass
        return True


@dataclass(frozen=True, slots=True)
class Integrity:
    """Damage of a campaign.

    Attributes
    ----------
    cells : dict of CellKey to str
        Damaged cells, and the damaged parts of each.
    others : tuple of str
        Sentences on all other damage: packings, runs, attempts, the file as such.
    """

    cells: dict[CellKey, str]
    others: tuple[str, ...]


class Closable(ABC):
    """What a `with` statement closes at its end."""

    @abstractmethod
    def close(self) -> None:
        """Release what is held; closing it again does nothing."""

    def __enter__(self) -> Self:
        """Use it in a `with` statement."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()
