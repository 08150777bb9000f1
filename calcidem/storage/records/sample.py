"""Frozen records of a sample: section, cement pattern, path, network."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.records.quantity import Along, Bound, Quantity, Record

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

    path_contacts: Annotated[int, _path("contacts on the preferential path")]
    path_hertz_contacts: Annotated[int, _path("uncemented contacts on it")]
    path_bonded_contacts: Annotated[int, _path("cemented contacts on it")]
    """N, N_h and N_LPB of the paper, with LP = N_LPB / N and PLLC = QLLC / N."""
    path_bonded_fraction: Annotated[float, _path("share of cemented contacts on it (LP)")]
    path_longest_bonded_run_fraction: Annotated[
        float, _path("longest run of cemented contacts over all contacts on it (PLLC)")
    ]
    path_longest_bonded_run: Annotated[
        float, _path("longest run of cemented contacts, mean over all shortest paths (QLLC)")
    ]
    path_connectivity: Annotated[float, _path("weighted shortest distance (C_d)")]
    path_normalized_connectivity: Annotated[float | None, _path("normalized connectivity per unit distance (C_d,n)")]
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

    network_conductance: Annotated[float | None, _network("conductance between the walls over that if all is cemented")]
    network_cemented_share: Annotated[float | None, _network("share of cemented contacts where the wave is")]
    network_strong_share: Annotated[float | None, _network("the same among contacts above the mean force")]
    network_coordination_number: Annotated[float | None, _network("cemented contacts of a cemented grain")]
    network_anisotropy: Annotated[
        float | None, Quantity("1", "anisotropy of the cemented contacts along the path", origin="network")
    ]
    network_components: Annotated[int, _network("groups of grains joined by cement")]
    network_largest_component: Annotated[int, _network("grains in the largest of them")]
    """A group has two or more grains; 0 where there is no cement."""
    network_gap_contacts: Annotated[
        int | None, _network("fewest uncemented contacts on a path from transmitter to receiver")
    ]
    """0 if cement alone connects transmitter and receiver, None if they are not connected."""
