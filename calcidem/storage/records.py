"""All records that callers of the store give and get: cells with their samples, attempts, runs, packings, campaigns.

Selections of cells, and the process that holds the lease of a campaign, are here, too. Records are frozen and hold SI
units (contents in percent of the sand's mass). A missing number is None in a record and NULL in the database, never
NaN. The outcome of a cell is its `CellStatus`. What the store has no columns for is canonical JSON with a hash, or
compressed arrays.
"""

import io
import json
import math
import os
import socket
import zipfile
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache, partial
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from calcidem.ends import CellStatus
from calcidem.input_file import zip_members
from calcidem.storage.errors import DAMAGE_REMEDY, CampaignMismatchError, DamagedStoreError, QueryError, hide_passwords
from calcidem.storage.quantity import Along, Bound, Quantity, Record


def config_difference(stored: str, given: str, *, shared_only: bool = False) -> list[str]:
    """List the differences of two configurations in JSON text, one line for each nested key.

    With ``shared_only`` keys that only one of both has are left out.

    Examples
    --------
    >>> config_difference('{"packing": {"friction": 0.2}}', '{"packing": {"friction": 0.5}}')
    ['packing.friction: 0.2 -> 0.5']
    """
    before, after = (flat_parameters(json.loads(text)) for text in (stored, given))
    shared, all_keys = before.keys() & after.keys(), before.keys() | after.keys()
    differing = {key for key in shared if before[key] != after[key]} | (set() if shared_only else all_keys - shared)

    def shown(values: Mapping[str, Any], key: str) -> str:
        return json.dumps(values[key], ensure_ascii=False) if key in values else "(not there)"

    return [f"{key}: {shown(before, key)} -> {shown(after, key)}" for key in sorted(differing)]


def flat_parameters(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested keys as one level, joined by points."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, dict) and value:
            flat |= flat_parameters(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


P_CONTACT = 1
C_CONTACT = 2
"""Kinds of a cemented contact in `CementPattern.kind`; in lists of all contacts 0 is a sand contact."""

_positive = partial(Quantity, bound=Bound.POSITIVE)
_path = partial(Quantity, "1", origin="path")
_network = partial(Quantity, "1", origin="network", bound=Bound.NOT_NEGATIVE)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedSection(Record):
    """Space-time section of a cell: motion at the stations and at the receiver, sampled at equal intervals."""

    sampling_interval: Annotated[float, _positive("s", "time between two samples")]
    """A multiple of the cell's time step."""
    start_time: Annotated[float, Quantity("s", "time of the first sample after the pulse began")]
    pulse_frequency: Annotated[float, _positive("Hz", "frequency of the pulse")]
    """f of the pulse ``v0 (1 - cos 2 pi f t)``."""
    resolution: Annotated[float, _positive("m s-1", "velocity of one count, 2^-20 of v0")]
    places: Annotated[NDArray[np.float64], Along("station", "m", "path to each station, and last to the receiver")]
    """Shape (X,)."""
    across: Annotated[NDArray[np.int32], Along("sample", "1", "velocity across the path, counts", "station")]
    along: Annotated[NDArray[np.int32], Along("sample", "1", "velocity along the path, counts", "station")]
    """Shape (T, X)."""

    @property
    def time(self) -> NDArray[np.float64]:
        """Times of the samples after the pulse began [s], shape (T,)."""
        samples = np.arange(len(self.across), dtype=np.float64)
        return np.float64(self.start_time) + samples * np.float64(self.sampling_interval)

    @property
    def transmitted(self) -> NDArray[np.float64]:
        """Velocity of the transmitter [m/s], shape (T,)."""
        turns, amplitude = self.time * self.pulse_frequency, self.resolution * 2.0**20
        return np.where(turns < 1.0, amplitude * (1.0 - np.cos(2.0 * np.pi * turns)), 0.0)

    @property
    def received(self) -> NDArray[np.float64]:
        """Velocity of the receiver across the path [m/s], shape (T,)."""
        return np.asarray(self.across[:, -1] * self.resolution)


@dataclass(frozen=True, slots=True, eq=False)
class CementPattern(Record):
    """Bonded contacts of the packing, which determine the sample exactly."""

    contacts: Annotated[
        NDArray[np.int32], Along("contact", "1", "indices of the two grains of a bonded contact", width=2)
    ]
    """In the order of bonding. Shape (m, 2)."""
    kind: Annotated[NDArray[np.uint8], Along("contact", "1", "1 for a P contact, 2 for one in a C cluster")]
    """Shape (m,)."""
    cluster_centres: Annotated[
        NDArray[np.float64], Along("cluster", "m", "position of the centre of a C cluster", width=2)
    ]
    """Shape (k, 2)."""

    def __post_init__(self) -> None:
        Record.__post_init__(self)
        if not ((self.kind == P_CONTACT) | (self.kind == C_CONTACT)).all():
            raise ValueError("CementPattern.kind holds other values than 1 (P) and 2 (C); use these two.")


@dataclass(frozen=True, slots=True, eq=False)
class GrainPath(Record):
    """Preferential path of a cell, from the transmitter to the receiver."""

    grains: Annotated[NDArray[np.int32], Along("grain", "1", "index of a grain along the preferential path")]
    """Shape (n,)."""


@dataclass(frozen=True, slots=True)
class PathFeatures(Record):
    """Features of a cell's preferential path from the transmitter to the receiver."""

    path_contacts: Annotated[int, _path("number of contacts on the path", symbol="N")]
    path_hertz_contacts: Annotated[int, _path("number of sand contacts on the path", symbol="N_h")]
    path_bonded_contacts: Annotated[int, _path("number of cemented contacts on the path", symbol="N_LPB")]
    path_bonded_fraction: Annotated[
        float, _path("share of the path's contacts that are cemented, N_LPB / N", symbol="LP")
    ]
    path_longest_bonded_run_fraction: Annotated[
        float, _path("share of the path's contacts in its longest run of cemented ones, QLLC / N", symbol="PLLC")
    ]
    path_longest_bonded_run: Annotated[
        float,
        _path(
            "longest run of cemented contacts on the path, mean over all shortest paths",
            symbol="QLLC",
        ),
    ]
    path_connectivity: Annotated[
        float, _path("weighted length of the preferential path, omega_h N_h + omega_LPB N_LPB", symbol="C_d")
    ]
    path_normalized_connectivity: Annotated[
        float | None,
        _path(
            "weighted length of the path, 0 for a straight row of cemented median grains, 1 for one without cement",
            symbol="C_d,n",
        ),
    ]
    """C_d,n (Eq. 9); None where it is singular (equal weights)."""

    def __post_init__(self) -> None:
        Record.__post_init__(self)
        if self.path_hertz_contacts + self.path_bonded_contacts != self.path_contacts:
            raise ValueError(
                f"PathFeatures: {self.path_hertz_contacts} uncemented + {self.path_bonded_contacts} cemented contacts "
                f"are not the {self.path_contacts} of the path; the two must add up."
            )


@dataclass(frozen=True, slots=True)
class NetworkFeatures(Record):
    """Features of the cement of a cell as a network; see `calcidem.analysis.packing_graph.NETWORK_FEATURES`.

    None where there is nothing to count: no contact where the wave is, no cement, no path.
    """

    network_conductance: Annotated[
        float | None,
        _network(
            "current between the side walls over that if all is cemented; a sand contact conducts 0.01 of a bond",
            symbol="G",
        ),
    ]
    network_cemented_share: Annotated[
        float | None, _network("share of cemented contacts, weighted by the energy of the wave", symbol="S")
    ]
    network_strong_share: Annotated[
        float | None, _network("the same among contacts that carry more than the mean force", symbol="S_f")
    ]
    network_coordination_number: Annotated[
        float | None, _network("cemented contacts of a cemented grain", symbol="Z_b")
    ]
    network_anisotropy: Annotated[
        float | None,
        _network(
            "mean cos(2 angle to the path) of cemented contacts, weighted by energy", symbol="A_b", bound=Bound.NONE
        ),
    ]
    network_components: Annotated[int, _network("groups of grains joined by cement", symbol="K")]
    network_largest_component: Annotated[int, _network("grains in the largest of them", symbol="K_max")]
    """A group has two or more grains; 0 where there is no cement."""
    network_gap_contacts: Annotated[
        int | None, _network("fewest sand contacts on a path from transmitter to receiver", symbol="N_gap")
    ]
    """0 if cement alone connects transmitter and receiver, None if they are not connected."""


NORMAL_95 = 1.96
"""Half-width of the 95 % interval of a normal variable, in standard errors."""

MOST_PULSE_EFFECT = 0.02
"""Relative standard error by the strength of the pulse above which velocities do not belong to the sample."""

DERIVED_QUANTITIES = (
    Quantity(
        "1",
        "relative standard error of vs by reading, simulation and pulse",
        "error budget",
        name="vs_error",
        is_optional=True,
        needs=("reading_error", "numerical_error", "pulse_effect"),
        formula=lambda root, reading, numerical, pulse: root(
            reading * reading + numerical * numerical + pulse * pulse  # three independent parts
        ),
    ),
)
"""Quantities that are not stored; each follows from stored ones, and is missing if one of these is."""


def depends_on_pulse(pulse_effect: Any) -> Any:  # noqa: ANN401 - number or array
    """Whether a velocity depends on the pulse; False without a known effect (NaN)."""
    return pulse_effect > MOST_PULSE_EFFECT


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


def _storable(text: str) -> str:
    """Text that every database takes: file names may have bytes that are no UTF-8, and PostgreSQL takes no null.

    `TypeError` for what is no text, as in a damaged database.
    """
    return str.encode(text, "utf-8", "backslashreplace").decode().replace("\0", "\\0")


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
    vs_bias: Annotated[
        _Real, _reading("1", "relative excess of the fitted wave's peak over effective_vs by a short path in a strip")
    ] = None
    """By the fitted wave: it is known, and no part of an error."""
    reading_error: Annotated[_Real, _relative_error("relative standard error of the reading of vs")] = None
    effective_vs: Annotated[_Real, _speed("velocity of the fitted damped wave, mean of the known sides")] = None
    """Velocity of the sample, free of the choice of a peak and of the dispersion in a strip."""
    effective_error: Annotated[_Real, _relative_error("relative standard error of effective_vs")] = None
    effective_vs_other_side: Annotated[_Real, _speed("velocity of the fitted wave from the other side")] = None
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
    law: Annotated[str | None, Quantity("", "contact law of the wave", "check", is_exact=True)] = None
    numerical_error: Annotated[_Real, _check("relative standard error of the velocities by the simulation")] = None
    pulse_effect: Annotated[_Real, _check("relative standard error of the velocities by the sense of the pulse")] = None
    side_error: Annotated[_Real, _check("relative standard error of effective_vs from one side, by that side")] = None
    """Measured for the content, see `calcidem.dem.wave.check`."""
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
    packed: tuple[tuple[str, bytes], ...] = ()
    """Arrays that `pack` has compressed, each after the name of its field, which is None instead."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "status", CellStatus(self.status))
        object.__setattr__(self, "reason", _storable(self.reason))
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

    def pack(self) -> Self:
        """Return it with its arrays compressed; workers do so, since the one process that stores has no time to."""
        found = {name: record for name in ARRAY_RECORDS if (record := getattr(self, name)) is not None}
        blobs = (
            (name, pack_arrays({field.name: np.asarray(getattr(record, field.name)) for field in fields(record)}))
            for name, record in found.items()
        )
        absent: dict[str, Any] = dict.fromkeys(found)
        return replace(self, **absent, packed=(*self.packed, *blobs)) if found else self

    @property
    def vs_error(self) -> float | None:
        """Relative standard error of vs by reading, simulation and pulse; 1.96 of it on either side hold 95 %."""
        total = QUANTITY_BY_NAME["vs_error"]
        parts = [getattr(self, name) for name in total.needs]
        return None if total.formula is None or None in parts else float(total.formula(math.sqrt, *parts))

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


ARRAY_RECORDS: dict[str, type[GrainPath | RecordedSection | CementPattern]] = {
    "path": GrainPath,
    "section": RecordedSection,
    "cement": CementPattern,
}
"""Fields of `CellResult` with arrays, and their classes; each is a blob in the database and a group in a file."""


QUANTITY_BY_NAME = {
    quantity.name: quantity
    for quantity in (
        *CellKey.quantities(),
        *CellResult.quantities(),
        *DERIVED_QUANTITIES,
        # A cell may lack a part as a whole.
        *(replace(one, is_optional=True) for part in (PathFeatures, NetworkFeatures) for one in part.quantities()),
    )
}
"""Catalogue of all quantities of a cell, in the order of display."""

EXACT_QUANTITIES = tuple(quantity.name for quantity in QUANTITY_BY_NAME.values() if quantity.is_exact)
"""Quantities of a done cell with the same bits wherever the campaign is computed."""


@dataclass(frozen=True, slots=True)
class AttemptCount:
    """Numbers of attempts at a cell."""

    attempts: int = 0
    """Attempts so far, over all runs; the next one has the number ``attempts + 1``."""
    losses: int = 0
    """Number of these since the last retry during which the run died."""


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

    @property
    def identity(self) -> tuple[object, ...]:
        """Equal for the copies of one attempt at a cell in several databases, which number it differently."""
        return self.recorded, self.outcome, self.host, self.rank


@dataclass(frozen=True, slots=True)
class RunRecord:
    """Provenance of one run of the program on a campaign."""

    versions: Mapping[str, str]
    """Versions of Python, calcidem and the libraries its numbers depend on."""
    host: str
    cpu: str
    """Host of rank 0 and its CPU model."""
    ranks: int
    """Size of the MPI world, 1 without MPI."""
    launch_line: str
    """Command line without passwords."""
    started: datetime
    """With time zone; kept as UTC."""
    mpi_library: str | None = None
    """None without MPI."""
    git_commit: str | None = None
    """Commit of the source tree, None when installed from a package."""
    git_dirty: bool | None = None
    """Whether that tree had uncommitted changes."""
    slurm_job_id: str | None = None
    ended: datetime | None = None
    """Time of the end; None while the run lasts, or if it was killed."""
    exit_state: str | None = None
    """Description of the end."""

    def __post_init__(self) -> None:
        """Hide passwords, and refuse times without time zone."""
        object.__setattr__(self, "launch_line", _storable(hide_passwords(self.launch_line)))
        object.__setattr__(self, "started", as_utc(self.started))
        if self.ended is not None:
            object.__setattr__(self, "ended", as_utc(self.ended))


def as_utc(moment: datetime) -> datetime:
    """Return a time in UTC; `ValueError` for a time without time zone, which is ambiguous."""
    if moment.tzinfo is None:
        raise ValueError(f"{moment} has no time zone; use datetime.now(UTC).")
    return moment.astimezone(UTC)


_packing = partial(Quantity, origin="packing", bound=Bound.NOT_NEGATIVE)


@dataclass(frozen=True, slots=True, eq=False)
class PackingRecord(Record):
    """A packing with the report on its quality; the annotations explain its numbers."""

    index: Annotated[int, Quantity("1", "index of the packing")]
    """0 to k - 1 when a campaign has k packings."""
    hash: Annotated[str, Quantity("", "hash of what it was made from")]
    """Packings with the same hash may differ between versions."""
    x: Annotated[NDArray[np.float64], Along("grain", "m", "horizontal position of the centre")]
    y: Annotated[NDArray[np.float64], Along("grain", "m", "vertical position of the centre")]
    radius: Annotated[NDArray[np.float64], Along("grain", "m", "radius")]
    """Centres and radii of the disks [m]. Shape (grains,)."""
    width: Annotated[float, _packing("m", "width of the box", bound=Bound.POSITIVE)]
    height: Annotated[float, _packing("m", "height of the lid", bound=Bound.POSITIVE)]
    porosity: Annotated[float, _packing("1", "area of the voids over area of the box")]
    coordination_number: Annotated[float, _packing("1", "mean number of contacts of a grain")]
    coordination_number_without_rattlers: Annotated[
        float, _packing("1", "mean number of contacts of a grain that carries load")
    ]
    """2 N_contacts / N with and without rattlers."""
    wall_stress: Mapping[str, float]
    """Normal stress on each wall [Pa], by name of the wall."""
    mean_relative_overlap: Annotated[float, _packing("1", "mean overlap over mean diameter")]
    largest_relative_overlap: Annotated[float, _packing("1", "largest overlap over mean diameter")]
    unbalanced_ratio: Annotated[float, _packing("1", "mean unbalanced force over mean contact force")]
    seconds: Annotated[float, _packing("s", "computing time")]
    state: Annotated[bytes, Along("state_byte", "1", "complete state, a NumPy .npz file")]
    """Restores the packing bit for bit; its format is not interpreted here."""
    content_hash: Annotated[str, Quantity("", "hash of its own bits: disks, walls and forces")]
    """Identity of the packing itself."""

    def __post_init__(self) -> None:
        Record.__post_init__(self)
        if self.index < 0:
            raise ValueError(f"PackingRecord.index is {self.index}; packings count from 0.")
        if not (len(self.radius) and (self.radius > 0.0).all()):
            raise ValueError("PackingRecord.radius must hold positive radii of at least one grain.")
        for wall, stress in self.wall_stress.items():
            if not math.isfinite(stress):
                raise ValueError(f"PackingRecord.wall_stress[{wall!r}] is {stress}; give a finite stress in Pa.")

    def refuse_other(
        self, other: "PackingRecord", places: tuple[str, str] = ("the database", "what is to be stored")
    ) -> None:
        """Raise `CampaignMismatchError` unless two records are of the same packing; the message names both places."""
        same = ("index", "hash", "content_hash", "width", "height", "x", "y", "radius")  # a record may have been edited
        if all(np.array_equal(getattr(self, name), getattr(other, name)) for name in same):
            return
        origins = "" if self.hash == other.hash else f" (they are made from {self.hash} and {other.hash})"
        raise CampaignMismatchError(
            f"Packing {self.index} has the content hash {self.content_hash} in {places[0]} and {other.content_hash} in "
            f"{places[1]}{origins}.",
            "Cells of two packings can't be in one campaign: keep them in databases of their own. 'calcidem run' on a "
            "database uses its packing; new databases with a common folder CALCIDEM_CACHE get the same packing.",
        )


@dataclass(frozen=True, slots=True)
class CampaignRecord:
    """Configuration and plan of a campaign."""

    hash: str
    """Identity of the physics."""
    name: str
    """Unique name within the store."""
    config: str
    """The whole physical configuration as canonical JSON text (`canonical_json`)."""
    contents: tuple[float, ...]
    """Planned contents [%], ascending."""
    seeds: tuple[int, ...]
    """Planned seeds, ascending."""
    created: datetime
    """Time with time zone; kept as UTC."""

    def __post_init__(self) -> None:
        for field in ("hash", "name"):
            if not getattr(self, field):
                raise ValueError(f"CampaignRecord.{field} is empty; give a text.")
        object.__setattr__(self, "contents", tuple(sorted({canonical_content(c) for c in self.contents})))
        object.__setattr__(self, "seeds", tuple(sorted({checked_seed(s) for s in self.seeds})))
        object.__setattr__(self, "created", as_utc(self.created))

    @property
    def parameters(self) -> dict[str, Any]:
        """Configuration, by section and key; `DamagedStoreError` if it is no JSON text."""
        try:
            found: dict[str, Any] = json.loads(self.config)
        except ValueError as error:
            problem = f"The configuration of campaign {self.name!r} is damaged ({error})."
            raise DamagedStoreError(problem, DAMAGE_REMEDY) from error
        return found

    @property
    def physics_version(self) -> object:
        """Version of the physics of the program that computed it."""
        return self.parameters.get("physics_version", "unknown")

    @property
    def checksum(self) -> str:
        """SHA-256 of hash and configuration together, 64 hexadecimal digits."""
        return sha256(f"{self.hash}\n{self.config}".encode()).hexdigest()

    def refuse_other(self, given: "CampaignRecord") -> None:
        """Raise `CampaignMismatchError`, which lists the differences, unless `given` is of the same campaign.

        With equal hashes each may have keys that the other lacks, since keys at their defaults are not hashed. Values
        of common keys must be equal. This detects a default that was changed without a new version of the physics.
        """
        is_same_hash = self.hash == given.hash
        differences = config_difference(self.config, given.config, shared_only=is_same_hash)
        if is_same_hash and not differences:
            return
        lines = "\n  ".join(differences or ["(none in the configurations' text)"])
        raise CampaignMismatchError(
            f"The stored campaign '{self.name}' with the hash {self.hash} has another configuration than "
            f"'{given.name}' with the hash {given.hash} (stored -> given):\n  {lines}\n",
            "Give the old values to continue it, or a new database or campaign name for the new ones; seeds and "
            "contents may differ.",
        )


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


def canonical_json(config: Mapping[str, Any]) -> str:
    """Return JSON text that is the same for equal configurations: keys sorted, no spaces, shortest floats.

    `ValueError` for NaN and infinity.
    """
    return json.dumps(config, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def canonical_hash(config: Mapping[str, Any]) -> str:
    """Return the SHA-256 of `canonical_json`, as 64 hexadecimal digits."""
    return sha256(canonical_json(config).encode()).hexdigest()


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Compress named arrays into the bytes of a NumPy ``.npz`` file.

    Any later reader can open this format: ``numpy.load(io.BytesIO(blob))``. It is that of `numpy.savez_compressed`,
    except for the level of compression, which that function does not offer.
    """
    buffer = io.BytesIO()
    # For cement patterns the usual level of zlib, 6, takes four times as long and saves 4 % of the bytes.
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            file = io.BytesIO()  # members written piece by piece take longer
            np.lib.format.write_array(file, array, allow_pickle=False)
            member = zipfile.ZipInfo(f"{name}.npy")  # which has no time of its own
            archive.writestr(member, file.getvalue(), zipfile.ZIP_DEFLATED, 1)
    return buffer.getvalue()


def unpack_arrays(blob: bytes) -> dict[str, NDArray[Any]]:
    """Inverse of `pack_arrays`; the arrays are read-only. `ValueError` for other or damaged bytes."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, content in zip_members(blob).items():  # as `numpy.load` reads them
        start = 10 + int.from_bytes(content[8:10], "little")  # version 1: the header's length is before the header
        shape, is_fortran, dtype = _read_header(content[:start])
        values = np.frombuffer(content, dtype, offset=start)
        arrays[name.removesuffix(".npy")] = values.reshape(shape, order="F" if is_fortran else "C")
    return arrays


@lru_cache(1024)  # cached, since parsing takes longest and most cells have the same headers
def _read_header(header: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type in the header of an ``.npy`` file of version 1."""
    file = io.BytesIO(header)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("no array that `pack_arrays` wrote")
    found: tuple[tuple[int, ...], bool, np.dtype[Any]] = np.lib.format.read_array_header_1_0(file)
    return found
