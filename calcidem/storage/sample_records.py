"""Frozen records of a sample beyond single numbers: signals, cement pattern, preferential path."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.arrays import ComparedByValue, frozen_array, plain_finite_numbers

__all__ = ["CementPattern", "PathFeatures", "Signal"]

P_CONTACT = 1
C_CONTACT = 2


@dataclass(frozen=True, slots=True, eq=False)
class Signal(ComparedByValue):
    """Sent and received signals of a cell, sampled at equal intervals from t = 0.

    Parameters
    ----------
    time_step : float
        Interval between samples [s].
    sent_velocity : (samples,) array
        Velocity of the transmitter [m/s].
    received_force : (samples,) array
        Shear force on the receiver [N per metre of thickness].
    received_velocity : (samples,) array
        Mean velocity of the grains at the receiver [m/s].
    """

    time_step: float
    sent_velocity: NDArray[np.float64]
    received_force: NDArray[np.float64]
    received_velocity: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check and normalise the fields."""
        plain_finite_numbers(self)
        if self.time_step <= 0.0:
            raise ValueError(f"Signal.time_step is {self.time_step} s; give a positive time.")
        samples = np.shape(self.sent_velocity)[0] if np.ndim(self.sent_velocity) else 0
        for name in ("sent_velocity", "received_force", "received_velocity"):
            array = frozen_array("Signal", name, getattr(self, name), np.float64, (samples,))
            object.__setattr__(self, name, array)

    @property
    def time(self) -> NDArray[np.float64]:
        """Times of the samples [s], shape (samples,)."""
        return np.arange(self.sent_velocity.size, dtype=np.float64) * np.float64(self.time_step)


@dataclass(frozen=True, slots=True, eq=False)
class CementPattern(ComparedByValue):
    """Which contacts of the packing are bonded: enough to rebuild the sample exactly.

    Parameters
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
        contacts = frozen_array("CementPattern", "contacts", self.contacts, np.int32, (None, 2))
        kind = frozen_array("CementPattern", "kind", self.kind, np.uint8, (len(contacts),))
        centres = frozen_array(
            "CementPattern", "cluster_centres", self.cluster_centres, np.float64, (None, 2)
        )
        if not np.isin(kind, (P_CONTACT, C_CONTACT)).all():
            raise ValueError("CementPattern.kind holds other values than 1 (P) and 2 (C); use these two.")
        object.__setattr__(self, "contacts", contacts)
        object.__setattr__(self, "kind", kind)
        object.__setattr__(self, "cluster_centres", centres)


@dataclass(frozen=True, slots=True)
class PathFeatures:
    """Features of a cell's preferential path from the transmitter to the receiver.

    Parameters
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
        plain_finite_numbers(self)
        if self.hertz_contacts + self.bonded_contacts != self.contacts:
            raise ValueError(
                f"PathFeatures: {self.hertz_contacts} uncemented + {self.bonded_contacts} cemented contacts "
                f"are not the {self.contacts} of the path; the two must add up."
            )
        object.__setattr__(self, "path", tuple(int(grain) for grain in self.path))
