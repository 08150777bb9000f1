"""Frozen records of a sample beyond single numbers: signals, cement pattern, path, graph."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.records.arrays import ComparedByValue, freeze_array, normalize_numbers

P_CONTACT = 1
C_CONTACT = 2
"""What a cemented contact is in `CementPattern.kind`; 0 stands for sand where all contacts are listed."""


@dataclass(frozen=True, slots=True, eq=False)
class Signal(ComparedByValue):
    """Sent and received signals of a cell, sampled at equal intervals.

    Attributes
    ----------
    sampling_interval : float
        Time between two samples [s], a multiple of the cell's time step.
    start_time : float
        Time of the first sample after the pulse began [s].
    sent_velocity : (samples,) array
        Velocity of the transmitter [m/s].
    received_force : (samples,) array
        Shear force on the receiver [N per metre of thickness].
    received_velocity : (samples,) array
        Mean velocity of the grains at the receiver [m/s].
    """

    sampling_interval: float
    start_time: float
    sent_velocity: NDArray[np.float64]
    received_force: NDArray[np.float64]
    received_velocity: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        normalize_numbers(self)
        if self.sampling_interval <= 0.0:
            raise ValueError(f"Signal.sampling_interval is {self.sampling_interval} s; give a positive time.")
        samples = np.shape(self.sent_velocity)[0] if np.ndim(self.sent_velocity) else 0
        for name in ("sent_velocity", "received_force", "received_velocity"):
            array = freeze_array("Signal", name, getattr(self, name), np.float64, (samples,))
            object.__setattr__(self, name, array)

    @property
    def time(self) -> NDArray[np.float64]:
        """Times of the samples after the pulse began [s], shape (samples,)."""
        samples = np.arange(self.sent_velocity.size, dtype=np.float64)
        return np.float64(self.start_time) + samples * np.float64(self.sampling_interval)


@dataclass(frozen=True, slots=True, eq=False)
class CementPattern(ComparedByValue):
    """Which contacts of the packing are bonded: enough to rebuild the sample exactly.

    Attributes
    ----------
    contacts : (m, 2) int32 array
        Grain indices of the bonded contacts, in the order in which they were bonded.
    kind : (m,) uint8 array
        1 for a P contact, 2 for a contact inside a C cluster.
    cluster_centres : (k, 2) float64 array
        Centres of the C clusters [m].
    """

    contacts: NDArray[np.int32]
    kind: NDArray[np.uint8]
    cluster_centres: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        contacts = freeze_array("CementPattern", "contacts", self.contacts, np.int32, (None, 2))
        kind = freeze_array("CementPattern", "kind", self.kind, np.uint8, (len(contacts),))
        centres = freeze_array("CementPattern", "cluster_centres", self.cluster_centres, np.float64, (None, 2))
        if not ((kind == P_CONTACT) | (kind == C_CONTACT)).all():
            raise ValueError("CementPattern.kind holds other values than 1 (P) and 2 (C); use these two.")
        object.__setattr__(self, "contacts", contacts)
        object.__setattr__(self, "kind", kind)
        object.__setattr__(self, "cluster_centres", centres)


@dataclass(frozen=True, slots=True)
class PathFeatures:
    """Features of a cell's preferential path from the transmitter to the receiver.

    Attributes
    ----------
    contacts : int
        Contacts on the path, N.
    hertz_contacts : int
        Uncemented contacts on it, N_h.
    bonded_contacts : int
        Cemented contacts on it, N_LPB.
    bonded_fraction : float
        LP = N_LPB / N.
    longest_bonded_run_fraction : float
        PLLC = QLLC / N.
    longest_bonded_run : int
        Longest run of consecutive cemented contacts, QLLC.
    connectivity : float
        Weighted shortest distance C_d (Eq. 9 of the paper).
    normalized_connectivity : float or None
        C_d,n (Eq. 9); None where it is singular (equal weights).
    path : tuple of int
        Grain indices along the path, N + 1 of them or none if not kept.
    """

    contacts: int
    hertz_contacts: int
    bonded_contacts: int
    bonded_fraction: float
    longest_bonded_run_fraction: float
    longest_bonded_run: int
    connectivity: float
    normalized_connectivity: float | None
    path: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        normalize_numbers(self)
        if self.hertz_contacts + self.bonded_contacts != self.contacts:
            raise ValueError(
                f"PathFeatures: {self.hertz_contacts} uncemented + {self.bonded_contacts} cemented contacts "
                f"are not the {self.contacts} of the path; the two must add up."
            )
        object.__setattr__(self, "path", tuple(int(grain) for grain in self.path))


@dataclass(frozen=True, slots=True)
class GraphSummary:
    """What the contact graph of a cell is like as a whole.

    Attributes
    ----------
    contacts, bonded_contacts : int
        All contacts between grains, and the cemented ones among them.
    coordination_number : float
        2 contacts / grains, grains without contact included.
    components : int
        Groups of two or more grains that cement joins into one piece.
    largest_component : int
        Grains in the largest of them; 0 where there is no cement.
    gap_contacts : int or None
        Fewest uncemented contacts that any way from the transmitter to the receiver has; 0 where cement alone
        joins them, None where nothing does.

    Raises
    ------
    ValueError
        If a number is negative, or there are more cemented contacts than contacts.
    """

    contacts: int
    bonded_contacts: int
    coordination_number: float
    components: int
    largest_component: int
    gap_contacts: int | None

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        normalize_numbers(self)
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and value < 0:
                raise ValueError(f"GraphSummary.{field.name} is {value}; give a number of 0 or more.")
        if self.bonded_contacts > self.contacts:
            raise ValueError(
                f"GraphSummary.bonded_contacts is {self.bonded_contacts} of {self.contacts} contacts; "
                "cemented contacts are a part of all contacts."
            )
