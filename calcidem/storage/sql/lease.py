"""One master for a campaign: a row in the database, and for a SQLite file an operating-system lock beside it.

The lock decides between processes of one machine, even after a kill. The heartbeat in the row decides between machines,
since locks on network file systems are unreliable. The lock file also records the heartbeat of the last acknowledged
transaction. If the row is older or missing, SQLite has silently dropped the end of a damaged write-ahead log. The
package filelock (4.2) is not used: without locks of the file system (ENOLCK) it raises an error, or uses a file that
remains after a kill.
"""

import errno
import os
import socket
from contextlib import suppress
from dataclasses import asdict, fields
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import Connection, delete, insert, select, update

from calcidem.storage.errors import LeaseHeldError, LeaseLostError
from calcidem.storage.sql.tables import LEASE
from calcidem.storage.store import STALE_AFTER, LeaseHolder

try:
    import fcntl
except ImportError:
    HAS_LOCKS = False  # Windows
else:
    HAS_LOCKS = True


class Lease:
    """Right of one process to write a campaign: its row in the database, and a lock on ``<database>.lock``.

    The operating system releases the lock at any end of the process.

    Attributes
    ----------
    path : Path or None
        Lock file; None for a database without a file, where the row alone decides.
    token : str or None
        Mark of this process in its row, once the row is stored.
    """

    def __init__(self, database: Path | None) -> None:
        """Prepare without taking lock or row; `database` is the SQLite file."""
        self.path = None if database is None else Path(f"{database}.lock")
        self.token: str | None = None
        self._descriptor: int | None = None

    @property
    def held(self) -> bool:
        """Whether this process has the lock."""
        return self._descriptor is not None

    def acquire(self) -> bool:
        """Try to lock without waiting; False if another process has the lock.

        On a file system or system without locks (some cluster mounts, Windows) this succeeds with `held` False, and the
        row alone decides.
        """
        if not HAS_LOCKS or self.path is None:
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
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), self.path.stat()):
                    self._descriptor = descriptor
            if not self.held:  # its former holder removed the file between our open and our lock
                os.close(descriptor)
        return True

    def note(self, token: str, heartbeat: datetime) -> None:
        """Record that a transaction with this heartbeat is stored; does nothing without the lock."""
        if self._descriptor is not None:
            with suppress(OSError):  # a full disk: only a later loss of stored data would not be noticed
                os.pwrite(self._descriptor, f"{token} {heartbeat.isoformat(timespec='microseconds')}\n".encode(), 0)

    def forget(self) -> None:
        """Erase the record before the row is removed; does nothing without the lock."""
        if self._descriptor is not None:
            os.ftruncate(self._descriptor, 0)

    def release(self) -> None:
        """Unlock and remove the file; does nothing without the lock."""
        if self._descriptor is not None and self.path is not None:
            self.path.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._descriptor = None

    def acknowledged(self) -> tuple[str, datetime] | None:
        """Token and heartbeat of the last acknowledged transaction of a master that did not end regularly.

        They are in the lock file; None if it is missing or empty. Read it before the database.
        """
        try:
            token, heartbeat = ("" if self.path is None else self.path.read_text(encoding="ascii")).split()
            return token, datetime.fromisoformat(heartbeat)
        except (OSError, ValueError):
            return None

    @staticmethod
    def describe_loss(connection: Connection, acknowledged: tuple[str, datetime] | None) -> str | None:
        """Return a sentence about acknowledged data that a database lacks; None if it has everything."""
        if acknowledged is None:
            return None
        token, heartbeat = acknowledged
        row = connection.execute(select(LEASE).where(LEASE.c.token == token)).first()
        if row is not None and row.heartbeat >= heartbeat:
            return None
        since = "" if row is None else f"after {row.heartbeat:%Y-%m-%d %H:%M:%S.%f} and "
        return (
            f"What was stored {since}until {heartbeat:%Y-%m-%d %H:%M:%S.%f} UTC is no longer in the database: its "
            "write-ahead log was damaged, or the file is another. The cells concerned are pending and will be computed "
            "again."
        )

    def claim(self, connection: Connection, campaign_id: int, token: str) -> tuple[datetime, LeaseHolder | None]:
        """Write the row for this process in a writing transaction; return its first heartbeat and a dead former holder.

        A former holder on this machine is dead if this process has the lock. `LeaseHeldError` if it may be alive.
        """
        now, host = datetime.now(UTC), socket.gethostname()
        former = self.holder(connection, campaign_id, for_update=True)
        if former is not None:
            if former.may_live() and not (former.host == host and self.held):
                raise self.held_error(former)
            connection.execute(delete(LEASE).where(LEASE.c.campaign_id == campaign_id))
        holder = LeaseHolder(host, os.getpid(), now, now)
        connection.execute(insert(LEASE).values(campaign_id=campaign_id, token=token, **asdict(holder)))
        return now, former

    def refuse_other_masters(self, connection: Connection) -> None:
        """Raise `LeaseHeldError` if a living process other than this one writes a campaign."""
        for row in connection.execute(select(LEASE)).all():
            if row.token != self.token and (holder := LeaseHolder(*row[2:])).may_live():
                raise self.held_error(holder)

    def renew(self, connection: Connection) -> datetime:
        """Set the heartbeat to now and return it; `LeaseLostError` if the row belongs to another process."""
        heartbeat = datetime.now(UTC)
        renewed = connection.execute(update(LEASE).where(LEASE.c.token == self.token).values(heartbeat=heartbeat))
        if renewed.rowcount == 0:
            raise LeaseLostError(
                "Another process has taken this campaign over because this one was silent for too long.",
                "Nothing of this transaction was stored; end this process, the other one continues.",
            )
        return heartbeat

    @staticmethod
    def holder(connection: Connection, campaign_id: int, *, for_update: bool = False) -> LeaseHolder | None:
        """Return the holder of a campaign's lease, None without one."""
        columns = (LEASE.c[field.name] for field in fields(LeaseHolder))
        statement = select(*columns).where(LEASE.c.campaign_id == campaign_id)
        row = connection.execute(statement.with_for_update() if for_update else statement).first()
        return None if row is None else LeaseHolder(*row)

    @staticmethod
    def held_error(holder: LeaseHolder | None) -> LeaseHeldError:
        """Return an error that names the present master."""
        if holder is None:
            who, cure = "another process on this machine", "Wait until it has ended."
        else:
            who = f"process {holder.pid} on {holder.host} (last heartbeat at {holder.heartbeat:%H:%M:%S} UTC)"
            free = holder.heartbeat + STALE_AFTER
            cure = f"Wait until it has ended; if it died on another machine, its lease ends at {free:%H:%M:%S} UTC."
        return LeaseHeldError(f"The campaign is being written by {who}.", cure)
