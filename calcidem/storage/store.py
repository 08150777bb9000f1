"""Selections and summaries of a store, without the database."""

import os
import socket
from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Self

from calcidem.ends import CellStatus
from calcidem.storage.errors import QueryError
from calcidem.storage.records import canonical_content, checked_seed

STALE_AFTER = timedelta(minutes=5)
"""Time without a heartbeat after which a master on another machine counts as dead."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Cells of a query; None means no restriction. `QueryError` for an unknown status."""

    seeds: tuple[int, ...] | None
    """One seed or a collection; the others likewise."""
    contents: tuple[float, ...] | None
    """Percent; compared as `canonical_content`."""
    statuses: tuple[CellStatus, ...] | None
    """May include `CellStatus.PENDING` for planned cells without an outcome."""
    where: str | None
    """Filter expression (`calcidem.storage.sql.tables.parse_where`)."""
    since: datetime | None
    """Only cells with an attempt recorded at this time or later."""

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
    """Numbers of a whole database; any change of a cell changes at least one."""

    cells: int
    attempts: int
    results: int
    """Numbers of planned cells, of attempts, and of stored outcomes."""
    recorded: datetime | None
    """Time at which the latest attempt was recorded (UTC)."""


@dataclass(frozen=True, slots=True)
class LeaseHolder:
    """Process that holds the lease of a campaign, or held it when it died."""

    host: str
    """Name of its machine."""
    pid: int
    """Number of the process."""
    machine: str
    """`this_machine` of the process."""
    started: str
    """`start_of` the process."""
    lock: str
    """Device and inode of the lock file that it has locked; empty without one."""
    acquired: datetime
    """Time at which it became the master (UTC)."""
    heartbeat: datetime
    """Time of its last heartbeat (UTC)."""

    @classmethod
    def of_this_process(cls, lock: str) -> Self:
        """Describe the calling process as a new master."""
        now = datetime.now(UTC)
        return cls(socket.gethostname(), os.getpid(), this_machine(), start_of(os.getpid()), lock, now, now)

    def is_here(self) -> bool:
        """Whether its process number has a meaning for this process."""
        return self.machine == this_machine()

    def may_live(self) -> bool:
        """Whether it may be alive; on another machine its heartbeat decides."""
        if datetime.now(UTC) - self.heartbeat > STALE_AFTER:
            return False
        return not self.is_here() or (self.started != "" and start_of(self.pid) == self.started)


def this_machine() -> str:
    """Equal for two processes if and only if process numbers have the same meaning for both.

    That is the same boot of the same kernel and the same namespace (containers); without ``/proc`` the host's name.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot} {Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        return socket.gethostname()


def start_of(pid: int) -> str:
    """Start time of a process in the kernel's clock ticks, since process numbers are used again; empty if it has ended.

    Without ``/proc`` any living process with this number counts as the same.
    """
    try:
        words = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b") ")[2].split()  # the name may contain spaces
    except OSError:
        if Path("/proc/self/stat").exists():
            return ""
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return ""
        except PermissionError:
            pass
        return "alive"
    return "" if words[0] in {b"Z", b"X"} else words[19].decode()  # a zombie has ended; proc(5), fields 3 and 22


class Closable(ABC):
    """Object that a `with` statement closes at its end."""

    @abstractmethod
    def close(self) -> None:
        """Release all resources; closing it again does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
