"""Frozen records of cells: identity, outcome and attempts.

A missing number is None in a record and NULL in the database, never NaN; what happened to a cell is its
`CellStatus`. Units are SI; contents are percent of the sand's mass.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from enum import StrEnum
from html import escape
from typing import Annotated, Any

from calcidem.storage.errors import DamagedStoreError
from calcidem.storage.records.arrays import normalize_numbers
from calcidem.storage.records.error_budget import DERIVED_QUANTITIES, vs_interval
from calcidem.storage.records.quantity import Bound, Quantity, check_bounds, quantities_of
from calcidem.storage.records.run import WorkerRecord
from calcidem.storage.records.sample import CementPattern, GrainPath, GraphSummary, PathFeatures, RecordedSection

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

    seed: Annotated[int, Quantity("1", "seed of the random cement pattern")]
    content: Annotated[float, Quantity("percent", "calcite content by mass of sand")]

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        object.__setattr__(self, "seed", checked_seed(self.seed))
        object.__setattr__(self, "content", canonical_content(self.content))


@dataclass(frozen=True, slots=True)
class CellResult:
    """Outcome of one cell with the numbers that say how far it can be trusted.

    The annotations of its fields are the catalogue of quantities: unit, meaning, origin and bounds of each. More than
    these say:

    Attributes
    ----------
    key : CellKey
        Which cell.
    status : CellStatus
        One of `STORED_STATUSES`, or damaged in what a store gives.
    reason : str
        Sentence that says why the status is not `done`; empty only for `done`.
    vs : float or None
        By the campaign's method; there if and only if `done`.
    distance, wavelengths_on_path : float or None
        From the transmitter to the receiver, and this over the wavelength vs / frequency. With fewer than two
        wavelengths on the path, near field and shear wave arrive together (section 3.1.3).
    expected_error, error_bound : float or None
        Numerical error that `vs` is expected to have, and one that it hardly exceeds.
    numerical_error, vs_error, path_departure : float or None
        Derived, see `calcidem.storage.records.error_budget`.
    retry : str or None
        Problem for which the sample was computed a second time; None if the first time was good.
    attempt : int
        Number of the attempt, counted from 1 over all runs: part of the outcome's identity (see `Store`).
    features, graph
        Path features and summary of the contact graph, where there are any.
    path, section, cement
        Arrays, where they were kept, and where the query asked for them (`ARRAY_RECORDS`).

    Raises
    ------
    ValueError
        If status and numbers disagree, or a number is NaN, infinite or out of bounds.
    """

    key: CellKey
    status: Annotated[CellStatus, Quantity("", "outcome of the cell", "measurement")]
    reason: Annotated[str, Quantity("", "why the outcome is what it is", "measurement")] = ""
    vs: Annotated[
        float | None, Quantity("m s-1", "shear-wave velocity", "reading", Bound.POSITIVE, is_exact=True, is_needed=True)
    ] = None
    vs_peak: Annotated[
        float | None,
        Quantity("m s-1", "shear-wave velocity from peak to peak", "reading", Bound.POSITIVE, is_exact=True),
    ] = None
    vs_first_arrival: Annotated[
        float | None,
        Quantity("m s-1", "shear-wave velocity by first arrival", "reading", Bound.POSITIVE, is_exact=True),
    ] = None
    vs_cross_correlation: Annotated[
        float | None,
        Quantity("m s-1", "shear-wave velocity by cross-correlation", "reading", Bound.POSITIVE, is_exact=True),
    ] = None
    coherence: Annotated[
        float | None, Quantity("1", "stack of the section along the line of the S wave", "reading", is_exact=True)
    ] = None
    reading_error: Annotated[
        float | None,
        Quantity("1", "relative standard error of the reading of vs", "reading", Bound.NOT_NEGATIVE, is_exact=True),
    ] = None
    path_vs: Annotated[
        float | None,
        Quantity("m s-1", "shear-wave velocity from station to station", "reading", Bound.POSITIVE, is_exact=True),
    ] = None
    path_error: Annotated[
        float | None,
        Quantity(
            "1", "relative standard error of the reading of path_vs", "reading", Bound.NOT_NEGATIVE, is_exact=True
        ),
    ] = None
    frequency: Annotated[
        float | None,
        Quantity("Hz", "frequency of the transmitted pulse", "wave", Bound.POSITIVE, is_exact=True, is_needed=True),
    ] = None
    distance: Annotated[
        float | None, Quantity("m", "distance that the shear wave travelled", "wave", Bound.POSITIVE, is_exact=True)
    ] = None
    wavelengths_on_path: Annotated[
        float | None, Quantity("1", "wavelengths on that distance", "reading", Bound.POSITIVE, is_exact=True)
    ] = None
    wavelength_over_d50: Annotated[
        float | None, Quantity("1", "wavelength over median diameter by mass", "reading", Bound.POSITIVE, is_exact=True)
    ] = None
    time_step: Annotated[
        float | None, Quantity("s", "time step", "wave", Bound.POSITIVE, is_exact=True, is_needed=True)
    ] = None
    stability_limit: Annotated[
        float | None, Quantity("s", "largest stable time step", "wave", Bound.POSITIVE, is_exact=True, is_needed=True)
    ] = None
    steps: Annotated[
        int | None, Quantity("1", "number of time steps", "wave", Bound.NOT_NEGATIVE, is_exact=True, is_needed=True)
    ] = None
    expected_error: Annotated[
        float | None, Quantity("1", "expected relative numerical error of vs", "error estimate", Bound.NOT_NEGATIVE)
    ] = None
    error_bound: Annotated[
        float | None, Quantity("1", "bound of the relative numerical error of vs", "error estimate")
    ] = None
    static_speed: Annotated[
        float | None, Quantity("m s-1", "velocity of long shear waves by statics", "statics", Bound.POSITIVE)
    ] = None
    content_reached: Annotated[
        float | None,
        Quantity(
            "percent",
            "calcite content of the cement placed, overlaps counted in full",
            "cement",
            Bound.NOT_NEGATIVE,
            is_exact=True,
        ),
    ] = None
    content_of_contacts: Annotated[
        float | None,
        Quantity(
            "percent", "calcite content of the cemented contacts by Eq. 2", "cement", Bound.NOT_NEGATIVE, is_exact=True
        ),
    ] = None
    p_contacts: Annotated[
        int | None, Quantity("1", "number of P contacts", "cement", Bound.NOT_NEGATIVE, is_exact=True)
    ] = None
    c_contacts: Annotated[
        int | None, Quantity("1", "number of contacts in C clusters", "cement", Bound.NOT_NEGATIVE, is_exact=True)
    ] = None
    clusters: Annotated[
        int | None, Quantity("1", "number of C clusters", "cement", Bound.NOT_NEGATIVE, is_exact=True)
    ] = None
    bonded_contacts: Annotated[
        int | None, Quantity("1", "number of bonded contacts", "cement", Bound.NOT_NEGATIVE, is_exact=True)
    ] = None
    broken_bonds: Annotated[
        int | None, Quantity("1", "number of bonds that the pulse broke", "wave", Bound.NOT_NEGATIVE, is_exact=True)
    ] = None
    retry: Annotated[str | None, Quantity("", "why the sample was computed again with half the step", "wave")] = None
    seconds: Annotated[float | None, Quantity("s", "computing time", "run", Bound.NOT_NEGATIVE)] = None
    rank: Annotated[int | None, Quantity("1", "MPI rank that computed it", "run", Bound.NOT_NEGATIVE)] = None
    host: Annotated[str | None, Quantity("", "host that computed it", "run")] = None
    attempt: Annotated[int, Quantity("1", "number of the attempt", "run", Bound.POSITIVE)] = 1
    packing_index: Annotated[int, Quantity("1", "which of the campaign's packings", "campaign", Bound.NOT_NEGATIVE)] = 0
    features: PathFeatures | None = None
    graph: GraphSummary | None = None
    path: GrainPath | None = None
    section: RecordedSection | None = None
    cement: CementPattern | None = None

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        object.__setattr__(self, "status", CellStatus(self.status))
        object.__setattr__(self, "retry", self.retry or None)
        normalize_numbers(self)
        if self.status not in (*STORED_STATUSES, CellStatus.DAMAGED):
            raise ValueError(f"CellResult.status is {self.status}; an outcome is one of {', '.join(STORED_STATUSES)}.")
        check_bounds(self)
        self._check_status()

    @property
    def numerical_error(self) -> float | None:
        """Relative standard error of vs by the simulation."""
        return self._derived("numerical_error")

    @property
    def vs_error(self) -> float | None:
        """Relative standard error of vs by simulation and reading; 1.96 of them on either side hold 95 %."""
        return self._derived("vs_error")

    @property
    def vs_interval(self) -> tuple[float, float] | None:
        """Interval that holds Vs with 95 %, m/s; None where `vs_error` is not known."""
        return None if self.vs_error is None else vs_interval(self.vs, self.vs_error)

    @property
    def path_departure(self) -> float | None:
        """Difference of path_vs and vs over its standard error; above `MOST_DEPARTURE` the cell is marked."""
        return self._derived("path_departure")

    def _repr_html_(self) -> str:
        """What is known of the cell, with units and meanings, for notebooks."""
        parts = [part for part in (self.key, self, self.features, self.graph) if part is not None]
        rows = []
        for quantity in QUANTITY_BY_NAME.values():
            value = next((found for part in parts if (found := getattr(part, quantity.name, None)) is not None), None)
            if value is not None and value != "":
                text = f"{value:.6g}" if quantity.kind == "real" else str(value)
                unit = "" if quantity.unit == "1" else quantity.unit
                entries = (quantity.name, f"{text} {unit}".rstrip(), quantity.meaning)
                rows.append("".join(f"<td>{escape(entry)}</td>" for entry in entries))
        kept = ", ".join(name for name in ARRAY_RECORDS if getattr(self, name) is not None)
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        arrays = f"<p>With the arrays {kept}.</p>" if kept else ""
        return f"<table><tr><th>quantity</th><th>value</th><th>meaning</th></tr>{body}</table>{arrays}"

    def _derived(self, name: str) -> float | None:
        quantity = QUANTITY_BY_NAME[name]
        values = [getattr(self, needed) for needed in quantity.needs]
        if quantity.formula is None or None in values:
            return None
        return float(quantity.formula(math.sqrt, *values))

    def refuse_damage(self) -> None:
        """Raise `DamagedStoreError` if the outcome is not what was stored."""
        if self.status is CellStatus.DAMAGED:
            raise DamagedStoreError(
                f"What is stored of seed {self.key.seed} and content {self.key.content} % is damaged: {self.reason}.",
                "'calcidem run CONFIG --retry damaged' computes such cells again.",
            )

    def _check_status(self) -> None:
        if self.status is CellStatus.DONE:
            missing = [q.name for q in quantities_of(CellResult) if q.is_needed and getattr(self, q.name) is None]
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
    columns : dict of str to value
        Quantities by name, except those that name the cell.
    arrays : dict of str to bytes
        Compressed arrays by the name of their field.
    worker : WorkerRecord or None
        What the process that computed it is, if it says so; its rank is the master's to fill in.
    """

    key: CellKey
    status: CellStatus
    attempt: int
    rank: int | None
    host: str | None
    columns: dict[str, Any]
    arrays: dict[str, bytes]
    worker: WorkerRecord | None = None


ARRAY_RECORDS: dict[str, type[GrainPath | RecordedSection | CementPattern]] = {
    "path": GrainPath,
    "section": RecordedSection,
    "cement": CementPattern,
}
"""Fields of `CellResult` that hold arrays, with their classes; each is a blob in the database and a group in a file."""


def _catalogue() -> Iterator[Quantity]:
    yield from quantities_of(CellKey)
    yield from quantities_of(CellResult)
    yield from DERIVED_QUANTITIES
    for part in (PathFeatures, GraphSummary):  # which a cell may lack as a whole
        yield from (replace(quantity, is_optional=True) for quantity in quantities_of(part))


QUANTITY_BY_NAME = {quantity.name: quantity for quantity in _catalogue()}
"""The catalogue: all quantities of a cell, in the order in which they are shown."""

EXACT_QUANTITIES = tuple(quantity.name for quantity in QUANTITY_BY_NAME.values() if quantity.is_exact)
"""Quantities of a done cell that are equal, to the last bit, wherever the same campaign is computed."""


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
