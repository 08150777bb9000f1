"""Contact weights and the connectivity C_d, C_d,n of a path (Eqs. 8 and 9 of the paper)."""

from dataclasses import dataclass
from typing import Self


@dataclass(frozen=True, slots=True)
class ContactWeights:
    """Dimensionless length that a contact of each kind adds to a path.

    Raises
    ------
    ValueError
        If 0 < bond <= hertz does not hold.
    """

    hertz: float
    """Weight of a sand contact, omega_h."""
    bond: float
    """Weight of a cemented contact, omega_LPB; at most that of a sand contact, because cement shortens the path."""

    def __post_init__(self) -> None:
        """Check the order of the weights."""
        if not 0 < self.bond <= self.hertz:
            raise ValueError(f"weights hertz = {self.hertz} and bond = {self.bond} must satisfy 0 < bond <= hertz")

    @classmethod
    def from_coordination_number(cls, coordination_number: float) -> Self:
        """Choose the weights by their physical meaning, Eq. 8: C^(-2/3) for sand, 1/C for cement, C = 2 N_c / N."""
        return cls(hertz=coordination_number ** (-2 / 3), bond=1 / coordination_number)

    @classmethod
    def from_ratio(cls, ratio: float) -> Self:
        """Choose the weights by their ratio omega_LPB / omega_h with omega_h = 1, as in Fig. 14."""
        return cls(hertz=1.0, bond=ratio)

    @property
    def ratio(self) -> float:
        """The ratio omega_LPB / omega_h, in (0, 1]."""
        return self.bond / self.hertz


def straight_contacts(distance: float, median_diameter: float) -> float:
    """Contacts of a straight row of median grains from transmitter to receiver, L / d50 - 1; both lengths in m.

    `ValueError` if 0 < median_diameter < distance does not hold.
    """
    if not 0 < median_diameter < distance:
        raise ValueError(
            f"median_diameter = {median_diameter} m and distance = {distance} m; "
            "the diameter must be positive and smaller than the distance"
        )
    return distance / median_diameter - 1


def connectivity(hertz_contacts: int, bonded_contacts: int, weights: ContactWeights) -> float:
    """Return C_d, the weighted length of a path of N_h sand contacts and N_LPB cemented ones, Eq. 9."""
    return weights.hertz * hertz_contacts + weights.bond * bonded_contacts


def normalized_connectivity(c_d: float, weights: ContactWeights, straight: float) -> float:
    """Return C_d,n, Eq. 9: 0 for a straight row of cemented contacts, 1 for a straight row of sand contacts.

    The weights are those of C_d; ``straight`` is from `straight_contacts`. `ValueError` for equal weights, since the
    definition divides by their difference.
    """
    if weights.bond == weights.hertz:
        raise ValueError(f"both weights are {weights.hertz}; C_d,n exists only where bond < hertz")
    return (c_d - weights.bond * straight) / ((weights.hertz - weights.bond) * straight)
