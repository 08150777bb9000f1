"""One master for a campaign: a row in the database, and for a SQLite file an operating-system lock beside it.

The lock decides at once between processes of one machine, even after a kill; the row's heartbeat decides
between machines, where locks on network file systems can't be relied on. The lock's file also notes the heartbeat that
the last acknowledged transaction stored: a row that is older, or gone, tells that SQLite dropped the end of a damaged
write-ahead log, which it does without a word. filelock (4.2) raises where a file system
has no locks (ENOLCK), or goes over to a file that a kill leaves behind: neither lets the row decide.
"""

import errno
import os
import socket
import uuid
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Self, cast

from sqlalchemy import CursorResult, delete, select, update
from sqlalchemy.orm import Session

from calcidem.storage.errors import LeaseHeldError, LeaseLostError
from calcidem.storage.sql.models import LeaseRow
from calcidem.storage.store import STALE_AFTER, LeaseGrant, LeaseHolder

try:
    import fcntl
except ImportError:
    HAS_LOCKS = False  # Windows
else:
    HAS_LOCKS = True


class FileLock:
    """An exclusive lock on ``<database>.lock``; the kernel drops it when the process ends, however it ends.

    Attributes
    ----------
    path : Path
        The lock file.
    """

    def __init__(self, database: Path) -> None:
        """Take no lock yet; `database` is the SQLite file."""
        self.path = Path(f"{database}.lock")
        self._descriptor: int | None = None

    @property
    def held(self) -> bool:
        """Whether this object has the lock."""
        return self._descriptor is not None

    def acquire(self) -> bool:
        """Try to lock without waiting; False if another process has the lock.

        A file system without locks (some cluster mounts), or a system without them (Windows), counts as success with
        `held` False: the row alone decides then.
        """
        if not HAS_LOCKS:
            return True
        while not self.held:
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                os.close(descriptor)
                if error.errno in {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS}:
                    return True
                if error.errno in {errno.EWOULDBLOCK, errno.EACCES}:
                    return False
                raise
            if self._is_current(descriptor):
                self._descriptor = descriptor
            else:  # its former holder removed the file between our open and our lock
                os.close(descriptor)
        return True

    def _is_current(self, descriptor: int) -> bool:
        try:
            return os.path.samestat(os.fstat(descriptor), self.path.stat())
        except FileNotFoundError:
            return False

    def note(self, token: str, heartbeat: datetime) -> None:
        """Write that a transaction of this lease, with this heartbeat, is stored; does nothing without the lock."""
        if self._descriptor is not None:
            with suppress(OSError):  # a full disk: then only the loss of what was stored would not be noticed
                os.pwrite(self._descriptor, f"{token} {heartbeat.isoformat(timespec='microseconds')}\n".encode(), 0)

    def forget(self) -> None:
        """Take the note back, before the row that it is compared with goes; does nothing without the lock."""
        if self._descriptor is not None:
            os.ftruncate(self._descriptor, 0)

    def release(self) -> None:
        """Unlock and remove the file; does nothing without the lock."""
        if self._descriptor is not None:
            self.path.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = None


@dataclass(frozen=True, slots=True)
class Acknowledged:
    """The last transaction that a master, which has not ended in order, was told to be stored.

    Attributes
    ----------
    token : str
        Of its lease.
    heartbeat : datetime
        That the transaction stored in the lease's row (UTC).
    """

    token: str
    heartbeat: datetime

    @classmethod
    def noted_beside(cls, database: Path) -> Self | None:
        """Read it from the lock file; None if there is none, or nothing is noted. To be read before the database is."""
        try:
            token, heartbeat = Path(f"{database}.lock").read_text(encoding="ascii").split()
            return cls(token, datetime.fromisoformat(heartbeat))
        except (OSError, ValueError):
            return None

    def describe_loss(self, session: Session) -> str | None:
        """Return a sentence on what a database lacks of what was acknowledged; None if it has everything."""
        row = session.scalar(select(LeaseRow).where(LeaseRow.token == self.token))
        if row is not None and row.heartbeat >= self.heartbeat:
            return None
        since = "" if row is None else f"after {row.heartbeat:%Y-%m-%d %H:%M:%S.%f} and "
        return (
            f"What was stored {since}until {self.heartbeat:%Y-%m-%d %H:%M:%S.%f} UTC is no longer in the database: its "
            "write-ahead log was damaged, or the file is another. The cells concerned are pending."
        )


def claim_lease(session: Session, campaign_id: int, *, former_is_dead: bool) -> tuple[LeaseGrant, datetime]:
    """Write the lease's row for this process.

    Parameters
    ----------
    session : Session
        In a writing transaction.
    campaign_id : int
    former_is_dead : bool
        Whether a former holder on this machine is known to be gone because this process has its file lock.

    Returns
    -------
    LeaseGrant, datetime
        And the first heartbeat.

    Raises
    ------
    LeaseHeldError
        If the holder may be alive.
    """
    now = datetime.now(UTC)
    host, taken_over_from = socket.gethostname(), None
    row = session.get(LeaseRow, campaign_id, with_for_update=True)
    if row is not None:
        former = holder_from_row(row)
        if former.may_live() and not (former.host == host and former_is_dead):
            raise lease_held_error(former)
        taken_over_from = (
            f"{former.host}, process {former.pid}, last heard of at {former.heartbeat:%Y-%m-%d %H:%M:%S} UTC"
        )
        session.delete(row)
        session.flush()
    token = uuid.uuid4().hex
    session.add(LeaseRow(campaign_id=campaign_id, token=token, host=host, pid=os.getpid(), acquired=now, heartbeat=now))
    return LeaseGrant(token, taken_over_from), now


def refuse_other_masters(session: Session, token: str | None) -> None:
    """Raise `LeaseHeldError` if a living process other than the one with this token writes a campaign."""
    for row in session.scalars(select(LeaseRow)):
        if row.token != token and (holder := holder_from_row(row)).may_live():
            raise lease_held_error(holder)


def holder_from_row(row: LeaseRow) -> LeaseHolder:
    """Build the holder of a lease from its row."""
    return LeaseHolder(row.host, row.pid, row.acquired, row.heartbeat)


def lease_held_error(holder: LeaseHolder | None) -> LeaseHeldError:
    """Return the error that names the present master."""
    if holder is None:
        who, cure = "another process on this machine", "Wait until it has ended."
    else:
        who = f"process {holder.pid} on {holder.host} (last heard of at {holder.heartbeat:%H:%M:%S} UTC)"
        free = holder.heartbeat + STALE_AFTER
        cure = f"Wait until it has ended; if it died on another machine, its lease ends at {free:%H:%M:%S} UTC."
    return LeaseHeldError(f"The campaign is being written by {who}.", cure)


def renew_lease(session: Session, token: str) -> datetime:
    """Move the heartbeat to now, and return it.

    Raises
    ------
    LeaseLostError
        If the row is another process's by now.
    """
    statement = update(LeaseRow).where(LeaseRow.token == token)
    heartbeat = datetime.now(UTC)
    result = cast("CursorResult[object]", session.execute(statement.values(heartbeat=heartbeat)))
    if result.rowcount == 0:
        raise LeaseLostError(
            "Another process has taken this campaign over because this one was silent for too long.",
            "Nothing of this transaction was stored; end this process, the other one goes on.",
        )
    return heartbeat


def drop_lease(session: Session, token: str) -> None:
    """Remove the row if it is still this master's."""
    session.execute(delete(LeaseRow).where(LeaseRow.token == token))
