"""Frozen records of cells: identity, outcome and attempts.

A missing number is None in a record and NULL in the database, never NaN. The outcome of a cell is its `CellStatus`.
Units are SI; contents are percent of the sand's mass.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from datetime import datetime
from functools import partial
from html import escape
from typing import Annotated, Any, Self

import numpy as np

from calcidem.ends import CellStatus
from calcidem.storage.records.arrays import pack_arrays
from calcidem.storage.records.error_budget import DERIVED_QUANTITIES, NORMAL_95
from calcidem.storage.records.quantity import Bound, Quantity, Record
from calcidem.storage.records.sample import CementPattern, GrainPath, NetworkFeatures, PathFeatures, RecordedSection

_Real = float | None
_Whole = int | None
_POSITIVE, _NOT_NEGATIVE = Bound.POSITIVE, Bound.NOT_NEGATIVE
_reading = partial(Quantity, origin="reading", is_exact=True)
_speed = partial(_reading, "m s-1", bound=_POSITIVE)
_relative_error = partial(_reading, "1", bound=_NOT_NEGATIVE)
_wave = partial(Quantity, origin="wave", bound=_POSITIVE, is_exact=True)
_check = partial(Quantity, "1", origin="check", bound=_NOT_NEGATIVE, is_exact=True)
_cement = partial(Quantity, origin="cement", bound=_NOT_NEGATIVE, is_exact=True)

LARGEST_SEED = 2**63 - 1
"""Largest integer that SQLite, PostgreSQL and NetCDF's int64 hold."""


STORED_STATUSES = tuple(s for s in CellStatus if s not in {CellStatus.PENDING, CellStatus.RUNNING})
"""Outcomes that a cell can have in the database."""

NOT_PLANNED = "not_planned"
"""Flag of a (seed, content) in the matrix that is not planned itself."""

STATUS_CODES = {name: code for code, name in enumerate((CellStatus.PENDING, *STORED_STATUSES, NOT_PLANNED))}
"""Values of the flag variable `status`; they never change, since files hold them."""


def canonical_content(content: float) -> float:
    """Return a content rounded to 1e-9 percent.

    Contents identify cells, and 0.1 + 0.2 must find the cells of 0.3. Rounding gives equal floats, which the database
    can compare exactly. 1e-9 percent is far below the cement of a single contact. `ValueError` unless
    0 <= content <= 100.
    """
    rounded = round(float(content), 9) + 0.0  # + 0.0 turns -0.0 into 0.0
    if not 0.0 <= rounded <= 100.0:  # percent; the comparison also refuses NaN
        raise ValueError(f"content is {content}; give percent of the sand's mass between 0 and 100.")
    return rounded


def checked_seed(seed: int) -> int:
    """Return a seed as Python's own integer; `ValueError` unless it is a whole number of 0 to `LARGEST_SEED`."""
    if isinstance(seed, float) or not 0 <= seed <= LARGEST_SEED:
        shown = seed if abs(seed) < 10**20 else "beyond that"
        raise ValueError(f"seed is {shown}; give a whole number of 0 to 2^63 - 1.")
    return int(seed)


@dataclass(frozen=True, slots=True, order=True)
class CellKey(Record):
    """Identity of a cell within its campaign."""

    seed: Annotated[int, Quantity("1", "seed of the random cement pattern")]
    """Number of the random cement pattern, 0 to `LARGEST_SEED`."""
    content: Annotated[float, Quantity("percent", "calcite content by mass of sand")]
    """Calcite content [% of sand mass], rounded by `canonical_content`."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", checked_seed(self.seed))
        object.__setattr__(self, "content", canonical_content(self.content))

    def __str__(self) -> str:
        """The cell as messages name it."""
        return f"seed {self.seed}, {self.content:g} %"


@dataclass(frozen=True, slots=True)
class CellResult(Record):
    """Outcome of one cell, with its errors.

    The annotations of its fields are the catalogue of quantities: unit, meaning, origin and bounds of each.
    `ValueError` if status and numbers disagree, or a number is NaN, infinite or out of bounds.
    """

    key: CellKey
    status: Annotated[CellStatus, Quantity("", "outcome of the cell", "measurement", codes=STATUS_CODES)]
    """One of `STORED_STATUSES`."""
    reason: Annotated[str, Quantity("", "why the outcome is what it is", "measurement")] = ""
    """A sentence; empty only for `done`."""
    vs: Annotated[_Real, _speed("shear-wave velocity", is_needed=True, ancillary="status vs_error")] = None
    """By the campaign's method; exists if and only if `done`."""
    vs_peak: Annotated[_Real, _speed("shear-wave velocity from peak to peak")] = None
    vs_first_arrival: Annotated[_Real, _speed("shear-wave velocity by first arrival")] = None
    vs_cross_correlation: Annotated[_Real, _speed("shear-wave velocity by cross-correlation")] = None
    vs_bias: Annotated[_Real, _reading("1", "relative excess of vs over effective_vs by a short path in a strip")] = (
        None
    )
    """By the fitted wave: it is known, and no part of an error."""
    reading_error: Annotated[_Real, _relative_error("relative standard error of the reading of vs")] = None
    effective_vs: Annotated[_Real, _speed("velocity of the damped wave that fits the section")] = None
    """Velocity of the sample, free of the choice of a peak and of the dispersion in a strip."""
    effective_error: Annotated[_Real, _relative_error("relative standard error of effective_vs")] = None
    coherence: Annotated[_Real, _reading("1", "mean squared correlation of section and fitted wave")] = None
    frequency: Annotated[_Real, _wave("Hz", "frequency of the transmitted pulse", is_needed=True)] = None
    distance: Annotated[_Real, _wave("m", "distance that the shear wave travelled")] = None
    """From the transmitter to the receiver."""
    wavelengths_on_path: Annotated[_Real, _reading("1", "wavelengths on that distance", bound=_POSITIVE)] = None
    """Distance over the wavelength vs / frequency. Below two, near field and shear wave arrive together (section
    3.1.3).
    """
    wavelength_over_d50: Annotated[_Real, _reading("1", "wavelength over median diameter by mass", bound=_POSITIVE)] = (
        None
    )
    time_step: Annotated[_Real, _wave("s", "time step", is_needed=True)] = None
    stability_limit: Annotated[_Real, _wave("s", "largest stable time step", is_needed=True)] = None
    steps: Annotated[_Whole, _wave("1", "number of time steps", bound=_NOT_NEGATIVE, is_needed=True)] = None
    law: Annotated[str | None, Quantity("", "contact law that the check chose", "check", is_exact=True)] = None
    numerical_error: Annotated[_Real, _check("relative standard error of the velocities by the simulation")] = None
    pulse_effect: Annotated[_Real, _check("relative standard error of the velocities by the pulse's strength")] = None
    """Both measured for the content, see `calcidem.dem.wave.check`."""
    static_speed: Annotated[
        _Real, Quantity("m s-1", "velocity of long shear waves by statics", "statics", _POSITIVE)
    ] = None
    content_reached: Annotated[
        _Real, _cement("percent", "calcite content of the cement placed, overlaps counted in full")
    ] = None
    content_of_contacts: Annotated[_Real, _cement("percent", "calcite content of the cemented contacts by Eq. 2")] = (
        None
    )
    p_contacts: Annotated[_Whole, _cement("1", "number of P contacts")] = None
    c_contacts: Annotated[_Whole, _cement("1", "number of contacts in C clusters")] = None
    clusters: Annotated[_Whole, _cement("1", "number of C clusters")] = None
    bonded_contacts: Annotated[_Whole, _cement("1", "number of bonded contacts")] = None
    broken_bonds: Annotated[_Whole, _wave("1", "number of bonds that the pulse broke", bound=_NOT_NEGATIVE)] = None
    retry: Annotated[str | None, Quantity("", "why the sample was computed again with half the step", "wave")] = None
    seconds: Annotated[_Real, Quantity("s", "computing time", "run", _NOT_NEGATIVE)] = None
    rank: Annotated[_Whole, Quantity("1", "MPI rank that computed it", "run", _NOT_NEGATIVE)] = None
    host: Annotated[str | None, Quantity("", "host that computed it", "run")] = None
    attempt: Annotated[int, Quantity("1", "number of the attempt", "run", _POSITIVE)] = 1
    """Counted from 1 over all runs; part of the outcome's identity (see `Store`)."""
    packing_index: Annotated[int, Quantity("1", "which of the campaign's packings", "campaign", _NOT_NEGATIVE)] = 0
    features: PathFeatures | None = None
    network: NetworkFeatures | None = None
    """Features of its preferential path and of its cement as a network, if known."""
    path: GrainPath | None = None
    section: RecordedSection | None = None
    cement: CementPattern | None = None
    """Arrays, if stored and requested by the query (`ARRAY_RECORDS`)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "status", CellStatus(self.status))
        object.__setattr__(self, "retry", self.retry or None)
        if self.status not in STORED_STATUSES:
            raise ValueError(f"CellResult.status is {self.status}; an outcome is one of {', '.join(STORED_STATUSES)}.")
        Record.__post_init__(self)
        self._check_status()

    @classmethod
    def from_values(cls, key: CellKey, values: Mapping[str, Any]) -> Self:
        """Build an outcome from its stored quantities and arrays by name; others are ignored.

        Features of path and network are complete or missing, except for quantities that were added later.
        """
        parts: dict[str, Any] = {name: values[name] for name in ARRAY_RECORDS if name in values}
        for field, kind in (("features", PathFeatures), ("network", NetworkFeatures)):
            names = [quantity.name for quantity in kind.quantities()]
            if any(values[name] is not None for name in names):
                parts[field] = kind(**{name: values[name] for name in names})
        return cls(key, **parts, **{quantity.name: values[quantity.name] for quantity in cls.quantities()})

    def values(self) -> dict[str, Any]:
        """Return its stored quantities by name, without those of the cell."""
        parts = [part for part in (self, self.features, self.network) if part is not None]
        return {q.name: getattr(part, q.name) for part in parts for q in part.quantities()}

    def packed(self) -> "PackedResult":
        """Convert it to the columns of its rows, with compressed arrays."""
        records = {name: record for name in ARRAY_RECORDS if (record := getattr(self, name)) is not None}
        arrays = {
            name: pack_arrays({field.name: np.asarray(getattr(record, field.name)) for field in fields(record)})
            for name, record in records.items()
        }
        return PackedResult(self.key, self.values(), arrays)

    @property
    def vs_error(self) -> float | None:
        """Relative standard error of vs by reading, simulation and pulse; 1.96 of it on either side hold 95 %."""
        return self._derived("vs_error")

    @property
    def vs_interval(self) -> tuple[float, float] | None:
        """95 % interval of Vs, m/s; None where `vs_error` is unknown."""
        if self.vs is None or self.vs_error is None:
            return None
        half = NORMAL_95 * self.vs_error * self.vs
        return self.vs - half, self.vs + half

    def _repr_html_(self) -> str:
        """Table of the cell's values with units and meanings, for notebooks."""
        known = {"seed": self.key.seed, "content": self.key.content} | self.values()
        rows = []
        for quantity in QUANTITY_BY_NAME.values():
            value = known.get(quantity.name, getattr(self, quantity.name, None))
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

    def _check_status(self) -> None:
        if self.status is CellStatus.DONE:
            missing = [q.name for q in CellResult.quantities() if q.is_needed and getattr(self, q.name) is None]
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
    """Outcome of one cell as the columns of its rows, with compressed arrays (`CellResult.packed`).

    Workers make it, since the one process that stores the outcomes of all workers has no time to compress them.
    """

    key: CellKey
    columns: dict[str, Any]
    """Quantities by name, except seed and content. The storing process replaces attempt, rank and host."""
    arrays: dict[str, bytes]
    """Compressed arrays by the name of their field."""

    @property
    def status(self) -> CellStatus:
        """Outcome of the cell."""
        return CellStatus(self.columns["status"])

    @property
    def attempt(self) -> int:
        """Number of the attempt."""
        return int(self.columns["attempt"])

    def packed(self) -> Self:
        """Return it unchanged."""
        return self


ARRAY_RECORDS: dict[str, type[GrainPath | RecordedSection | CementPattern]] = {
    "path": GrainPath,
    "section": RecordedSection,
    "cement": CementPattern,
}
"""Fields of `CellResult` with arrays, and their classes; each is a blob in the database and a group in a file."""


def _catalogue() -> Iterator[Quantity]:
    yield from CellKey.quantities()
    yield from CellResult.quantities()
    yield from DERIVED_QUANTITIES
    for part in (PathFeatures, NetworkFeatures):  # which a cell may lack as a whole
        yield from (replace(quantity, is_optional=True) for quantity in part.quantities())


QUANTITY_BY_NAME = {quantity.name: quantity for quantity in _catalogue()}
"""Catalogue of all quantities of a cell, in the order of display."""

EXACT_QUANTITIES = tuple(quantity.name for quantity in QUANTITY_BY_NAME.values() if quantity.is_exact)
"""Quantities of a done cell with the same bits wherever the campaign is computed."""


@dataclass(frozen=True, slots=True)
class AttemptCount:
    """Numbers of attempts at a cell."""

    attempts: int = 0
    """Attempts so far, over all runs; the next one has the number ``attempts + 1``."""
    losses: int = 0
    """Number of these since the last retry that ended with the loss of the worker."""


@dataclass(frozen=True, slots=True)
class AttemptRecord(Record):
    """One attempt at a cell."""

    key: CellKey
    number: Annotated[int, Quantity("1", "number of the attempt", bound=_POSITIVE)]
    """Counted from 1."""
    outcome: Annotated[str, Quantity("", "outcome")]
    """A `CellStatus` value, running while it is computed, or ``"lost"`` if the run died meanwhile."""
    reason: Annotated[str, Quantity("", "why")]
    rank: Annotated[_Whole, Quantity("1", "MPI rank")]
    host: Annotated[str | None, Quantity("", "host")]
    seconds: Annotated[_Real, Quantity("s", "computing time", bound=_NOT_NEGATIVE)]
    recorded: datetime
    """Time of storing (UTC)."""
    run_id: Annotated[_Whole, Quantity("1", "number of the run")] = None
    """Run of this attempt."""
    forgiven: bool = False
    """Whether a retry came after it; its loss then no longer counts."""

    def __post_init__(self) -> None:
        Record.__post_init__(self)
        if self.outcome not in (known := (*STORED_STATUSES, "lost", CellStatus.RUNNING)):
            raise ValueError(f"AttemptRecord.outcome is '{self.outcome}'; it is one of {', '.join(known)}.")
