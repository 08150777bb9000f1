"""Errors of the store: each has cause and remedy."""


class StoreError(Exception):
    """Base of all errors of the store.

    Attributes
    ----------
    problem : str
        The cause, with the place (file or URL) and the value.
    cure : str
        The remedy.
    """

    def __init__(self, problem: str, cure: str) -> None:
        super().__init__(f"{problem} {cure}")
        self.problem = problem
        self.cure = cure

    def __reduce__(self) -> tuple[type["StoreError"], tuple[str, str]]:
        """Pickle with both arguments, so that an error can be sent between MPI ranks."""
        return type(self), (self.problem, self.cure)


class StoreLockedError(StoreError):
    """Another process kept the database locked for longer than the waiting time."""


class DiskError(StoreError):
    """Reading or writing the file failed: the disk, a quota, or the network behind the file system."""


class DiskFullError(DiskError):
    """The disk has no space for the transaction; nothing of it was stored."""


class ReadOnlyStoreError(StoreError):
    """The file, its folder or the server session doesn't allow writing."""


class StoreUnavailableError(StoreError):
    """The file can't be opened, or the database server can't be reached."""


class StoreInterruptedError(StoreUnavailableError):
    """The server ended an open connection: it was restarted, or the network failed."""


class ForeignDatabaseError(StoreError):
    """The file or database exists but was not made by calcidem."""


class OtherSchemaError(StoreError):
    """An earlier or later calcidem wrote the database or file; this version does not read its tables."""


class DamagedStoreError(StoreError):
    """The file's content is damaged."""


DAMAGE_REMEDY = (
    "It was not written to. Move it away, check the disk, and 'calcidem import' an earlier export into a new "
    "database, or compute the campaign again; 'sqlite3 FILE .recover' saves what can be read."
)
"""Remedy for a damaged database."""


class OutputRefusedError(StoreError):
    """An output file has the name of a database or of another file, or an unknown format."""


class ReplacedStoreError(StoreError):
    """The database file was removed or replaced while it was being written."""


class CampaignMismatchError(StoreError):
    """The campaign exists with another physical configuration, or another packing."""


class UnknownCampaignError(StoreError):
    """The store has no such campaign, or several of which one has to be named."""


class UnknownCellError(StoreError):
    """A cell that is not part of the campaign's plan."""


class InvalidRecordError(StoreError):
    """The database's constraints refused a record."""


class QueryError(StoreError):
    """A filter expression that can't be understood."""


class LeaseHeldError(StoreError):
    """Another process is the master of this campaign."""


class LeaseLostError(StoreError):
    """Another process has taken over the campaign; this one must not write any more."""
