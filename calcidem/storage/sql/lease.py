"""One master for a campaign: a row in the database, and for a SQLite file an operating-system lock beside it.

The lock decides between processes of one machine, even after a kill. The heartbeat in the row decides between machines,
since locks on network file systems are unreliable. The lock file also records the heartbeat of the last acknowledged
transaction. If the row is older or missing, SQLite has silently dropped the end of a damaged write-ahead log. The
package filelock (4.2) is not used: without locks of the file system (ENOLCK) it raises an error, or uses a file that
remains after a kill.
"""

import errno
import os
import stat
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import Connection, delete, insert, select, update

from calcidem.storage.errors import DiskError, LeaseHeldError, LeaseLostError, OutputRefusedError, StoreUnavailableError
from calcidem.storage.files import BESIDE_A_DATABASE, flush_to_disk, refuse_to_replace, replace_file
from calcidem.storage.records import STALE_AFTER, LeaseHolder
from calcidem.storage.sql.tables import LEASE, exclude_others

try:
    import fcntl
except ImportError:
    HAS_LOCKS = False  # Windows
else:
    HAS_LOCKS = True


_HELD: "weakref.WeakSet[Lease]" = weakref.WeakSet()
"""Leases with a lock."""


class Lease:
    """Right of one process to write a campaign: its row in the database, and a lock on ``<database>.lock``.

    The operating system releases the lock at any end of the process. Its forked children do not have it.

    Attributes
    ----------
    path : Path or None
        Lock file; None for a database without a file, where the row alone decides.
    token : str or None
        Mark of this process in its row, once the row is stored.
    """

    def __init__(self, database: Path | None) -> None:
        """Prepare without taking lock or row; `database` is the SQLite file, without symbolic links."""
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
        row alone decides. `StoreUnavailableError` if another program made the lock file.
        """
        if not HAS_LOCKS or self.path is None:
            return True
        while not self.held:
            descriptor = self._open(os.O_RDWR | os.O_CREAT)
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
                if os.path.samestat(os.fstat(descriptor), self.path.lstat()):
                    self._descriptor = descriptor
                    _HELD.add(self)
            if not self.held:  # its former holder removed the file between our open and our lock
                os.close(descriptor)
        return True

    def _open(self, flags: int) -> int:
        """Open the lock file; `StoreUnavailableError` unless it is a regular file that calcidem wrote."""
        safely = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK  # no link of a user, no wait for the end of a pipe
        try:
            descriptor = os.open(str(self.path), flags | safely, 0o666)
        except OSError as error:
            if error.errno not in {errno.ELOOP, errno.EISDIR, errno.ENXIO}:
                raise
            is_own = False
        else:
            status = os.fstat(descriptor)
            is_own = stat.S_ISREG(status.st_mode) and status.st_nlink <= 1
            is_own = is_own and os.pread(descriptor, 8, 0) in {b"", b"calcidem"}
            if is_own:
                return descriptor
            os.close(descriptor)
        raise StoreUnavailableError(
            f"{self.path} is needed for the lock of the database, but is a link or was not written by calcidem.",
            "Move it away; nothing was changed.",
        )

    def note(self, token: str, heartbeat: datetime) -> None:
        """Record that a transaction with this heartbeat is stored; does nothing without the lock."""
        if self._descriptor is not None:
            text = f"calcidem {token} {heartbeat.isoformat(timespec='microseconds')}\n"
            with suppress(OSError):  # a full disk: only a later loss of stored data would not be noticed
                os.pwrite(self._descriptor, text.encode(), 0)

    def forget(self) -> None:
        """Erase the record before the row is removed; does nothing without the lock."""
        if self._descriptor is not None:
            os.ftruncate(self._descriptor, 0)

    def release(self) -> None:
        """Unlock and remove the file, unless it still has a record; does nothing without the lock."""
        if self._descriptor is not None and self.path is not None:
            if os.fstat(self._descriptor).st_size == 0:
                self.path.unlink(missing_ok=True)
            self.close_lock()

    def close_lock(self) -> None:
        """Close the lock file; the lock ends if no other process shares it."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
            _HELD.discard(self)

    @staticmethod
    def close_locks() -> None:
        """Close all lock files in a forked process: it is no master, and would hold the locks as long as it lives."""
        for lease in list(_HELD):
            lease.close_lock()

    def acknowledged(self) -> tuple[str, datetime] | None:
        """Token and heartbeat of the last acknowledged transaction of a master that did not end regularly.

        They are in the lock file; None if it is missing or empty. Read it before the database.
        """
        if self.path is None:
            return None
        descriptor = self._descriptor
        try:
            descriptor = self._open(os.O_RDONLY) if descriptor is None else descriptor
            _, token, heartbeat = os.pread(descriptor, 200, 0).decode("ascii").split()
            return token, datetime.fromisoformat(heartbeat)
        except (OSError, ValueError, StoreUnavailableError):
            return None
        finally:
            if descriptor not in {None, self._descriptor}:
                os.close(descriptor)

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

        `LeaseHeldError` if the former holder may be alive. It is dead if this process has the lock that it had.
        """
        exclude_others(connection)
        former = self.holder(connection, campaign_id, for_update=True)
        holder = LeaseHolder.of_this_process(self._identity())
        if former is not None:
            boots = (holder.machine.partition(" ")[0], former.machine.partition(" ")[0])  # locks hold for one kernel
            has_its_lock = boots[0] == boots[1] and former.lock == holder.lock != ""
            if former.may_live() and not has_its_lock:
                raise self.held_error(former)
            connection.execute(delete(LEASE).where(LEASE.c.campaign_id == campaign_id))
        connection.execute(insert(LEASE).values(campaign_id=campaign_id, token=token, **asdict(holder)))
        return holder.heartbeat, former

    def _identity(self) -> str:
        """Device and inode of the locked file; empty without the lock."""
        if self._descriptor is None:
            return ""
        status = os.fstat(self._descriptor)
        return f"{status.st_dev}:{status.st_ino}"

    def refuse_other_masters(self, connection: Connection) -> None:
        """Raise `LeaseHeldError` if a living process other than this one writes a campaign."""
        for row in connection.execute(select(*_HOLDER, LEASE.c.token)).all():
            if row.token != self.token and (holder := LeaseHolder(*row[:-1])).may_live():
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
        statement = select(*_HOLDER).where(LEASE.c.campaign_id == campaign_id)
        row = connection.execute(statement.with_for_update() if for_update else statement).first()
        return None if row is None else LeaseHolder(*row)

    @staticmethod
    def held_error(holder: LeaseHolder | None) -> LeaseHeldError:
        """Return an error that names the present master."""
        if holder is None:
            return LeaseHeldError(
                "The database is being written by another run on this machine.", "Wait until it has ended."
            )
        free = holder.heartbeat + STALE_AFTER
        return LeaseHeldError(
            f"The campaign is being written by process {holder.pid} on {holder.host} (last heartbeat at "
            f"{holder.heartbeat:%H:%M:%S} UTC).",
            f"Wait until it has ended; if it died on another machine, its lease ends at {free:%H:%M:%S} UTC.",
        )


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=Lease.close_locks)

_HOLDER = tuple(LEASE.c[field.name] for field in fields(LeaseHolder))


def refuse_hard_links(path: Path) -> None:
    """Raise `StoreUnavailableError` if a file has several names."""
    if (names := path.stat().st_nlink) > 1:
        raise StoreUnavailableError(
            f"{path} has {names} names (hard links): two programs could write it without noticing.",
            "Remove the other names, or work on a copy.",
        )


@contextmanager
def replace_database(path: Path) -> Iterator[Path]:
    """Yield a temporary file that becomes the database at a path once the block has ended without error.

    Whatever makes a database, or replaces one, does it here: while nobody else may write it, and without the files that
    SQLite keeps beside a database. These belonged to a database that was removed; SQLite would copy them into the new
    one. `LeaseHeldError` if another process writes it or makes it; `OutputRefusedError` if a file appeared meanwhile;
    `DiskError` if the data did not all reach the temporary file.
    """
    if path.exists():
        refuse_hard_links(path)
    else:
        refuse_to_replace(path)  # names that belong to another database
        most = os.pathconf(path.parent, "PC_NAME_MAX") - len("-journal")
        if len(os.fsencode(path.name)) > most:
            raise StoreUnavailableError(
                f"{path} has a name too long for the files beside a database.", f"Give one of at most {most} bytes."
            )
    before = _identity_of(path)  # first: another process may make it while this one waits
    lease = Lease(path)
    deadline = time.monotonic() + 5.0  # s; making an empty database takes a tenth of one
    while not lease.acquire():
        if time.monotonic() > deadline:
            raise lease.held_error(None)
        time.sleep(0.05)
    try:
        with replace_file(path) as temporary:
            yield temporary
            log = Path(f"{temporary}-wal")
            if log.is_file() and log.stat().st_size:  # SQLite does not tell that it could not empty it
                raise DiskError(
                    f"{path} could not be written: the last of its data did not reach the file.",
                    "Free some space, and run the same command again; nothing was replaced.",
                )
            if _identity_of(path) != before:
                raise OutputRefusedError(
                    f"{path} was made, removed or replaced by another process meanwhile.",
                    "It was left as it is. Give another file name, or run the same command again.",
                )
            flush_to_disk(temporary)  # a disk that is full must not cost the former database its log
            for end in BESIDE_A_DATABASE:
                Path(f"{path}{end}").unlink(missing_ok=True)
        lease.forget()
    finally:
        lease.release()


def _identity_of(path: Path) -> tuple[int, int] | None:
    """Device and inode of a file; None if it does not exist."""
    with suppress(FileNotFoundError):
        status = path.stat()
        return status.st_dev, status.st_ino
    return None
