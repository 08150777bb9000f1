"""The contract that every store keeps."""

import os
import socket
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from types import TracebackType
from typing import Any, Self

from numpy.typing import NDArray

from calcidem.storage.records import (
    AttemptCount,
    AttemptRecord,
    CampaignRecord,
    CellKey,
    CellResult,
    CellStatus,
    PackedResult,
    PackingRecord,
    RecordedSection,
    RunRecord,
    canonical_content,
    checked_seed,
)

RETRIED_BY_DEFAULT = (CellStatus.FAILED, CellStatus.TIMED_OUT)

STALE_AFTER = timedelta(minutes=5)
"""A master on another machine without a heartbeat for this long counts as dead."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Which cells a query is about; None means no restriction.

    Attributes
    ----------
    seeds : collection of int, optional
    contents : collection of float, optional
        Percent; compared as `canonical_content`.
    statuses : collection of CellStatus, optional
        May include `CellStatus.PENDING` for planned cells without an outcome.
    where : str, optional
        Filter expression (`calcidem.storage.sql.where.parse_where`).
    """

    seeds: Collection[int] | None = None
    contents: Collection[float] | None = None
    statuses: Collection[CellStatus] | None = None
    where: str | None = None

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        if self.seeds is not None:
            object.__setattr__(self, "seeds", tuple(sorted({checked_seed(seed) for seed in self.seeds})))
        if self.contents is not None:
            object.__setattr__(self, "contents", tuple(sorted({canonical_content(c) for c in self.contents})))
        if self.statuses is not None:
            object.__setattr__(self, "statuses", tuple(CellStatus(status) for status in self.statuses))


ALL_CELLS = Selection()


@dataclass(frozen=True, slots=True)
class LeaseGrant:
    """The right to write a campaign.

    Attributes
    ----------
    token : str
        Identity of this master.
    taken_over_from : str or None
        ``host, process N, last heard of at T`` of a dead master whose lease this one took over; to be
        reported.
    lost : str or None
        A sentence on what the dead master stored and is no longer there; to be reported.
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
        When it was last heard of (UTC).
    """

    host: str
    pid: int
    acquired: datetime
    heartbeat: datetime

    def may_live(self) -> bool:
        """Whether it may be alive, as far as can be told from this machine: on another one its heartbeat decides."""
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
    """What of a campaign is no longer what was stored.

    Attributes
    ----------
    cells : dict of CellKey to str
        Damaged cells, and what is damaged of each.
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


class Store(Closable):
    """Campaigns, their cells and their outcomes, kept for good.

    Rules that hold for every implementation:

    1. A store holds any number of campaigns with different names. `begin_campaign` or `use_campaign`
       chooses the one that all other methods are about.
    2. A campaign's physics never changes: its name goes with one hash. Its plan of seeds and contents only
       grows.
    3. Each writing method is one transaction: when it returns, all of it is on disk; when it raises,
       nothing is.
    4. Writing the same thing again changes nothing. A result is identified by its cell and the number of
       its attempt.
    5. A done cell stays as it is unless `replace_done` is asked for. Any other outcome gives way to one of
       the same or a later attempt, and to a done one.
    6. A cell without an outcome is pending. Every outcome settles its cell; `retry` makes settled cells
       pending again and keeps their history.
    7. Attempts are counted from 1 for each cell over all runs, those whose worker was lost included. The
       caller gives a result the number ``attempts + 1`` of `attempt_counts`.
    8. Callers get frozen records, never rows; errors are `StoreError` with cause and cure.
    9. At most one process holds the lease of a campaign. Once its lease has been taken over, a store
       refuses to write. Writing without ever having asked for the lease is allowed, for imports and single
       commands.
    10. Reading never blocks a writer for longer than one short query, and sees only whole transactions.
    11. A cell whose stored outcome is not what was stored is `CellStatus.DAMAGED` in whatever reads the damaged part;
       nothing of it is given but its key and what is damaged. `retry_damaged` makes it pending.
    12. Before a campaign is chosen, whatever is about one raises `UnknownCampaignError`. Writing may raise
        `ReadOnlyStoreError`, `LeaseLostError` or `DiskFullError`, and any method another `StoreError` of its database.
        A `Selection` whose filter can't be understood raises `QueryError`.

    A store is a context manager that closes itself. It may be used by one thread at a time.
    """

    # Campaigns and runs

    @abstractmethod
    def campaigns(self) -> tuple[CampaignRecord, ...]:
        """All campaigns, oldest first."""

    @abstractmethod
    def begin_campaign(self, campaign: CampaignRecord) -> CampaignRecord:
        """Create the campaign, or continue the one with the same hash and extend its plan by what is new.

        Returns
        -------
        CampaignRecord
            As stored: with the seeds and contents of all plans so far.

        Raises
        ------
        CampaignMismatchError
            If the name is taken by a campaign with another hash; the message lists the differences, one
            nested key a line.
        """

    @abstractmethod
    def use_campaign(self, name: str | None = None) -> CampaignRecord:
        """Choose an existing campaign; without a name the only one there is.

        Raises
        ------
        UnknownCampaignError
            If there is none of that name, or several and no name was given.
        """

    @abstractmethod
    def extend(self, seeds: Iterable[int], contents: Iterable[float]) -> int:
        """Plan all cells of seeds x contents (percent) that are not planned yet; return how many were added."""

    @abstractmethod
    def begin_run(self, run: RunRecord) -> int:
        """Store the provenance of a run and return its number.

        Attempts recorded from here on belong to it.
        """

    @abstractmethod
    def end_run(self, exit_state: str, ended: datetime) -> None:
        """Store how and when the run of `begin_run` ended.

        Raises
        ------
        UnknownCampaignError
            If no run was begun.
        """

    @abstractmethod
    def runs(self) -> tuple[tuple[int, RunRecord], ...]:
        """All runs of the campaign with their numbers, oldest first."""

    # Lease

    @abstractmethod
    def acquire_lease(self) -> LeaseGrant:
        """Become the campaign's only master; asked again, it refreshes the lease.

        Raises
        ------
        LeaseHeldError
            If another living process is it; the message says which, and when it would count as dead.
        """

    @abstractmethod
    def renew_lease(self) -> None:
        """Say that this master is alive; recording does it too. Call it at least every minute.

        Raises
        ------
        LeaseLostError
            If another process took over.
        """

    @abstractmethod
    def lease_holder(self) -> LeaseHolder | None:
        """Return who holds the lease, None if nobody does; it may have died (`LeaseHolder.may_live`)."""

    @abstractmethod
    def release_lease(self) -> None:
        """Give the lease back; does nothing without one."""

    # Writing

    @abstractmethod
    def save_packing(self, packing: PackingRecord, *, replace_state: bool = False) -> None:
        """Store a packing under its index; the same one is left as it is, but gets a content hash that it lacks.

        Parameters
        ----------
        packing : PackingRecord
        replace_state : bool
            Whether its state takes the place of a stored one, which is damaged.

        Raises
        ------
        CampaignMismatchError
            If the index has another packing; the message names the content hashes of both.
        """

    @abstractmethod
    def record_results(self, results: Iterable[CellResult | PackedResult], *, replace_done: bool = False) -> int:
        """Store outcomes in one transaction (rules 4 and 5).

        Returns
        -------
        int
            How many were stored; the others were kept out by rule 5.

        Raises
        ------
        UnknownCellError
            If a cell is not planned.
        """

    @abstractmethod
    def record_lost(self, keys: Iterable[CellKey], reason: str) -> dict[CellKey, AttemptCount]:
        """Count one attempt that ended with the loss of its worker for each cell; return the new counts.

        Unlike the other writes each call counts, since a loss has no result to be recognised by.

        Raises
        ------
        UnknownCellError
            If a cell is not planned.
        """

    @abstractmethod
    def retry(
        self, statuses: Collection[CellStatus] = RETRIED_BY_DEFAULT, keys: Iterable[CellKey] | None = None
    ) -> tuple[CellKey, ...]:
        """Make settled cells pending again, and forget the losses counted for them.

        Parameters
        ----------
        statuses : collection of CellStatus
            Which outcomes; done is refused.
        keys : iterable of CellKey, optional
            Only these cells.

        Returns
        -------
        tuple of CellKey
            The cells that are pending again.

        Raises
        ------
        ValueError
            If `statuses` contains done, pending or running.
        """

    @abstractmethod
    def retry_damaged(self, keys: Collection[CellKey]) -> None:
        """Make damaged cells (of `integrity`) pending again, and drop their attempts that are damaged."""

    @abstractmethod
    def restore_attempts(self, attempts: Iterable[AttemptRecord]) -> None:
        """Store a history as another store kept it (for imports); attempts that are there already stay.

        Raises
        ------
        UnknownCellError
            If a cell is not planned.
        """

    # Reading

    @abstractmethod
    def load_packing(self, index: int = 0) -> PackingRecord | None:
        """Return a packing, or None if there is none of that index."""

    @abstractmethod
    def content_hashes(self) -> dict[int, str | None]:
        """Return the content hash of each stored packing by its index, ascending; None where an old one has none."""

    def packing_indices(self) -> tuple[int, ...]:
        """Return the indices of the stored packings, ascending."""
        return tuple(self.content_hashes())

    @abstractmethod
    def pending(
        self, seeds: Collection[int] | None = None, contents: Collection[float] | None = None
    ) -> tuple[CellKey, ...]:
        """Return the planned cells without an outcome, by seed, then content (percent); by default all."""

    @abstractmethod
    def statuses(self, selection: Selection = ALL_CELLS) -> dict[CellKey, CellStatus]:
        """Status of each selected cell, by seed, then content; pending where it has no outcome."""

    @abstractmethod
    def status_counts(self) -> dict[tuple[float, CellStatus], int]:
        """Return how many planned cells each content (percent) has of each status; zeros are left out."""

    @abstractmethod
    def attempt_counts(self, keys: Iterable[CellKey] | None = None) -> dict[CellKey, AttemptCount]:
        """Count the attempts of these cells, or of all that were tried; a cell never tried counts 0."""

    @abstractmethod
    def history(self, selection: Selection = ALL_CELLS) -> Iterator[AttemptRecord]:
        """All attempts at the selected cells, by seed, content and number."""

    @abstractmethod
    def results(self, selection: Selection = ALL_CELLS, *, with_arrays: bool = False) -> Iterator[CellResult]:
        """Outcomes of the selected cells, by seed, then content; fetched as they are consumed.

        Parameters
        ----------
        selection : Selection
        with_arrays : bool
            Whether to load paths, sections and cement patterns, some 50 kB a cell; without it they are None.
        """

    @abstractmethod
    def integrity(self) -> Integrity:
        """Compare everything that is stored of the campaign with its checksums, and let the database check itself."""

    def section(self, key: CellKey) -> RecordedSection | None:
        """Return the section of a cell, None if it was not kept.

        Raises
        ------
        DamagedStoreError
            If they, or something else of the cell, are not what was stored.
        """
        found = next(self.results(Selection((key.seed,), (key.content,)), with_arrays=True), None)
        if found is not None:
            found.refuse_damage()
        return None if found is None else found.section

    @abstractmethod
    def table(
        self,
        names: Sequence[str],
        selection: Selection = ALL_CELLS,
        *,
        sort: Sequence[str] = (),
        limit: int | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Return columns of the selected planned cells in one query.

        Parameters
        ----------
        names : sequence of str
            From `calcidem.storage.records.QUANTITY_BY_NAME`.
        selection : Selection
        sort : sequence of str
            Quantities to sort by, ``-`` before a name for descending; missing values come last. What is equal is
            in the order of seed, then content.
        limit : int, optional
            Give the first so many cells only.

        Returns
        -------
        dict of str to (cells,) array
            Object arrays for texts (None where missing), int64 for seeds, and float64 for all other numbers (NaN where
            missing), in the units of the quantities.

        Raises
        ------
        QueryError
            For an unknown quantity, a filter that can't be understood, or a negative limit.
        """

    # Life

    @abstractmethod
    def close(self) -> None:
        """Release the lease and all connections; a closed store may be closed again."""
