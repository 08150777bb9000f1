"""Frozen records of cells: identity, outcome and attempts.

A missing number is None in a record and NULL in the database, never NaN; what happened to a cell is its
`CellStatus`. Units are SI; contents are percent of the sand's mass.
"""

import math
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any

from calcidem.storage.errors import DamagedStoreError
from calcidem.storage.records.arrays import normalize_numbers
from calcidem.storage.records.sample import CementPattern, GraphSummary, PathFeatures, Signal

_CONTENT_DECIMALS = 9

LARGEST_SEED = 2**63 - 1
"""What SQLite, PostgreSQL and NetCDF's int64 hold, exactly."""


class CellStatus(StrEnum):
    """What happened to a cell.

    The first two are never stored: they are the absence of an outcome. Nor is the last: it is what is found where a
    stored outcome was changed.
    """

    PENDING = "pending"
    RUNNING = "running"
    DONE = "done"
    NO_ARRIVAL = "no_arrival"
    UNSTABLE = "unstable"
    FAILED = "failed"
    TIMED_OUT = "timed_out"
    QUARANTINED = "quarantined"
    DAMAGED = "damaged"


STORED_STATUSES = tuple(s for s in CellStatus if s not in {CellStatus.PENDING, CellStatus.RUNNING, CellStatus.DAMAGED})
"""The outcomes a cell can have in the database."""

NOT_PLANNED = "not_planned"
"""Flag of a (seed, content) that is in the matrix only because others of its row and column are planned."""

STATUS_CODES = {
    name: code for code, name in enumerate((CellStatus.PENDING, *STORED_STATUSES, NOT_PLANNED, CellStatus.DAMAGED))
}
"""Values of the flag variable `status`; never renumbered, since old files hold them."""


def canonical_content(content: float) -> float:
    """Return the one float that stands for a content: rounded to 1e-9 percent.

    Contents identify cells, and 0.1 + 0.2 must find the cells of 0.3. Any two floats that agree to nine
    decimals round to the same float64, so that the database can compare exactly; 1e-9 percent is far below
    the cement of a single contact.

    Raises
    ------
    ValueError
        Unless 0 <= content <= 100.
    """
    rounded = round(float(content), _CONTENT_DECIMALS) + 0.0  # + 0.0 turns -0.0 into 0.0
    if not 0.0 <= rounded <= 100.0:  # noqa: PLR2004 - percent; the comparison also refuses NaN
        raise ValueError(f"content is {content}; give percent of the sand's mass between 0 and 100.")
    return rounded


def checked_seed(seed: int) -> int:
    """Return a seed as Python's own integer.

    Raises
    ------
    ValueError
        Unless it is a whole number of 0 to `LARGEST_SEED`.
    """
    if isinstance(seed, float) or not 0 <= seed <= LARGEST_SEED:
        shown = seed if abs(seed) < 10**20 else "beyond that"
        raise ValueError(f"seed is {shown}; give a whole number of 0 to 2^63 - 1.")
    return int(seed)


@dataclass(frozen=True, slots=True, order=True)
class CellKey:
    """Identity of a cell within its campaign.

    Attributes
    ----------
    seed : int
        Number of the random cement pattern, 0 to `LARGEST_SEED`.
    content : float
        Calcite content [% of sand mass]; stored as `canonical_content` of what is given.
    """

    seed: int
    content: float

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        object.__setattr__(self, "seed", checked_seed(self.seed))
        object.__setattr__(self, "content", canonical_content(self.content))


@dataclass(frozen=True, slots=True)
class CellResult:
    """Outcome of one cell with the numbers that say how far it can be trusted.

    Attributes
    ----------
    key : CellKey
        Which cell.
    status : CellStatus
        One of `STORED_STATUSES`, or damaged in what a store gives.
    reason : str
        Sentence that says why the status is not `done`; empty only for `done`.
    vs : float or None
        Shear-wave velocity [m/s] by the campaign's method: a positive number if and only if `done`.
    vs_peak, vs_first_arrival, vs_cross_correlation : float or None
        Velocity by each method [m/s]; None where that pick failed.
    quality_peak, quality_first_arrival, quality_cross_correlation : float or None
        Quality figure of each pick.
    frequency : float or None
        Frequency of the pulse [Hz].
    distance : float or None
        From the transmitter to what is listened to [m]: the way of the travel times.
    wavelengths_on_path, wavelength_over_d50 : float or None
        That distance over the wavelength vs / frequency, and the wavelength over the median diameter by mass: with
        fewer than two wavelengths on the path, near field and shear wave arrive together (section 3.1.3).
    time_step, stability_limit : float or None
        Step and the limit it was taken from [s].
    steps : int or None
        Steps made.
    expected_error, error_bound : float or None
        Numerical error that `vs` is expected to have, and one that it hardly exceeds, both relative.
    static_speed : float or None
        Velocity of long shear waves [m/s] from the static stiffness of the sample, where it was asked for.
    content_reached : float or None
        Content the whole contacts and clusters add up to [%]; where clusters overlap each counts in full.
    content_of_contacts : float or None
        Content by Eq. 2 over the cemented contacts, each counted once [%].
    p_contacts, c_contacts, clusters, bonded_contacts : int or None
        P contacts, contacts in C clusters, C clusters, and all bonded contacts.
    broken_bonds : int or None
        Bonds that broke while the wave was recorded; None where it is not known.
    retry : str or None
        Problem for which the sample was sent a second time, with half the step; None if the first time was good.
    seconds : float or None
        Computing time of this cell [s].
    rank, host : int or None, str or None
        Where it was computed.
    attempt : int
        Number of the attempt, counted from 1 over all runs: part of the outcome's identity (see `Store`).
    packing_index : int
        Which of the campaign's packings.
    features, graph, signal, cement
        Path features, summary of the contact graph, signals and cement pattern where they were kept, and where the
        query asked for them.

    Raises
    ------
    ValueError
        If status and numbers disagree, or a number is NaN, infinite or out of range.
    """

    key: CellKey
    status: CellStatus
    reason: str = ""
    vs: float | None = None
    vs_peak: float | None = None
    vs_first_arrival: float | None = None
    vs_cross_correlation: float | None = None
    quality_peak: float | None = None
    quality_first_arrival: float | None = None
    quality_cross_correlation: float | None = None
    frequency: float | None = None
    distance: float | None = None
    wavelengths_on_path: float | None = None
    wavelength_over_d50: float | None = None
    time_step: float | None = None
    stability_limit: float | None = None
    steps: int | None = None
    expected_error: float | None = None
    error_bound: float | None = None
    static_speed: float | None = None
    content_reached: float | None = None
    content_of_contacts: float | None = None
    p_contacts: int | None = None
    c_contacts: int | None = None
    clusters: int | None = None
    bonded_contacts: int | None = None
    broken_bonds: int | None = None
    retry: str | None = None
    seconds: float | None = None
    rank: int | None = None
    host: str | None = None
    attempt: int = 1
    packing_index: int = 0
    features: PathFeatures | None = None
    signal: Signal | None = None
    cement: CementPattern | None = None
    graph: GraphSummary | None = None

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        object.__setattr__(self, "status", CellStatus(self.status))
        object.__setattr__(self, "retry", self.retry or None)
        normalize_numbers(self)
        if self.status not in (*STORED_STATUSES, CellStatus.DAMAGED):
            raise ValueError(f"CellResult.status is {self.status}; an outcome is one of {', '.join(STORED_STATUSES)}.")
        if self.attempt < 1 or self.packing_index < 0:
            raise ValueError(
                f"CellResult.attempt is {self.attempt} and packing_index {self.packing_index}; "
                "attempts count from 1 and packings from 0."
            )
        for name in POSITIVE_COLUMNS:
            value = getattr(self, name)
            if value is not None and value <= 0.0:
                raise ValueError(f"CellResult.{name} is {value}; give a positive number, or None if there is none.")
        for name in COUNT_COLUMNS:
            value = getattr(self, name)
            if value is not None and value < 0:
                raise ValueError(f"CellResult.{name} is {value}; give a count of 0 or more, or None.")
        self._check_status()

    def refuse_damage(self) -> None:
        """Raise `DamagedStoreError` if the outcome is not what was stored."""
        if self.status is CellStatus.DAMAGED:
            raise DamagedStoreError(
                f"What is stored of seed {self.key.seed} and content {self.key.content} % is damaged: {self.reason}.",
                "'calcidem retry DB --damaged' has such cells computed anew.",
            )

    def _check_status(self) -> None:
        if self.status is CellStatus.DONE:
            missing = [name for name in NUMERICS_OF_DONE if getattr(self, name) is None]
            if missing:
                raise ValueError(
                    f"CellResult of a done cell lacks {', '.join(missing)}; a stored vs states its numerics."
                )
            return
        if self.vs is not None:
            raise ValueError(f"CellResult.vs is {self.vs} but the status is {self.status}; only a done cell has a vs.")
        if not self.reason:
            raise ValueError(f"CellResult.reason is empty but the status is {self.status}; say why in a sentence.")


@dataclass(frozen=True, slots=True)
class PackedResult:
    """Outcome of one cell as the columns of its rows, arrays compressed (`calcidem.storage.sql.rows.pack_result`).

    A worker makes it, so that the bytes that travel are those that are stored: the one process that stores the outcomes
    of all workers has no time to compress them.

    Attributes
    ----------
    key : CellKey
    status : CellStatus
    attempt : int
    rank, host : int or None, str or None
        As in `CellResult`; like there, whoever stores the outcome may replace these three.
    columns : dict of str to dict
        Columns by the name of their table, for each table that gets a row; those that name the cell, the attempt
        and its place are added when it is stored.
    """

    key: CellKey
    status: CellStatus
    attempt: int
    rank: int | None
    host: str | None
    columns: dict[str, dict[str, Any]]


POSITIVE_COLUMNS = (
    "vs",
    "vs_peak",
    "vs_first_arrival",
    "vs_cross_correlation",
    "frequency",
    "distance",
    "wavelengths_on_path",
    "wavelength_over_d50",
    "static_speed",
    "time_step",
    "stability_limit",
)
"""Fields of `CellResult` that are positive or None."""

COUNT_COLUMNS = (
    "steps",
    "p_contacts",
    "c_contacts",
    "clusters",
    "bonded_contacts",
    "broken_bonds",
    "seconds",
    "rank",
    "expected_error",
    "content_reached",
    "content_of_contacts",
)
"""Fields of `CellResult` that are 0 or more, or None."""

NUMERICS_OF_DONE = ("vs", "frequency", "time_step", "stability_limit", "steps")
"""Fields that a done cell must have."""


@dataclass(frozen=True, slots=True)
class AttemptCount:
    """How often a cell was tried.

    Attributes
    ----------
    attempts : int
        Attempts so far, over all runs; the next one has the number ``attempts + 1``.
    losses : int
        How many of them since the last retry ended with the loss of the worker.
    """

    attempts: int = 0
    losses: int = 0


@dataclass(frozen=True, slots=True)
class AttemptRecord:
    """One attempt at a cell.

    Attributes
    ----------
    key : CellKey
    number : int
        Counted from 1.
    outcome : str
        A `CellStatus` value, or ``"lost"`` when the worker vanished.
    reason : str
    rank : int or None
    host : str or None
    seconds : float or None
    recorded : datetime
        When it was stored (UTC).
    run_id : int or None
        The run that made it.
    forgiven : bool
        Whether a retry came after it: its loss then counts no longer.
    """

    key: CellKey
    number: int
    outcome: str
    reason: str
    rank: int | None
    host: str | None
    seconds: float | None
    recorded: datetime
    run_id: int | None = None
    forgiven: bool = False

    def __post_init__(self) -> None:
        """Check the fields."""
        if self.number < 1:
            raise ValueError(f"AttemptRecord.number is {self.number}; attempts count from 1.")
        if self.seconds is not None and not 0.0 <= self.seconds < math.inf:
            raise ValueError(f"AttemptRecord.seconds is {self.seconds}; give a time of 0 or more, or None.")
        if self.outcome not in (known := (*STORED_STATUSES, "lost")):
            raise ValueError(f"AttemptRecord.outcome is '{self.outcome}'; it is one of {', '.join(known)}.")
