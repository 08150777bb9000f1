"""The shortest path for every ratio of the two weights at once.

With omega_h = 1 and r = omega_LPB / omega_h, a path of N_h sand and N_LPB cemented contacts has length N_h +
r N_LPB: a straight line over r. The length of the shortest path is the lower envelope of these lines, and it
has only a few corners. So instead of a search for every sample and every ratio, the envelope of a sample is
found with a few searches and then holds exactly for all ratios.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from calcidem.analysis.connectivity import ContactWeights
from calcidem.analysis.contact_graph import ContactGraph, preferential_path

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


class PathLine(NamedTuple):
    """Numbers of contacts on a path, which make the line N_h + r N_LPB over the ratio r."""

    hertz_contacts: int
    bond_contacts: int


@dataclass(frozen=True, slots=True)
class PathEnvelope:
    """The shortest path length of one sample as a function of the weight ratio.

    Parameters
    ----------
    lines
        The paths that are shortest somewhere, in order of the ratio: N_LPB falls and N_h grows from each to
        the next.
    low, high
        The ratios between which the envelope holds.
    """

    lines: tuple[PathLine, ...]
    low: float
    high: float

    @property
    def corners(self) -> tuple[float, ...]:
        """The ratios at which one path takes over from the one before."""
        return tuple(
            (after.hertz_contacts - before.hertz_contacts) / (before.bond_contacts - after.bond_contacts)
            for before, after in zip(self.lines[:-1], self.lines[1:], strict=True)
        )

    def connectivity(self, ratio: ArrayLike) -> NDArray[np.float64]:
        """Give C_d for omega_h = 1 and omega_LPB = `ratio`.

        Parameters
        ----------
        ratio
            Ratios between `low` and `high`, any shape.

        Returns
        -------
        numpy.ndarray
            Same shape as `ratio`.

        Raises
        ------
        ValueError
            If a ratio lies outside.
        """
        ratios = np.asarray(ratio, dtype=np.float64)
        if ratios.size and not (self.low <= ratios.min() and ratios.max() <= self.high):
            raise ValueError(
                f"ratio spans {ratios.min()} to {ratios.max()}, the envelope {self.low} to {self.high}; "
                "find the envelope over a wider range"
            )
        hertz, bond = np.array(self.lines, dtype=np.float64).T
        lengths: NDArray[np.float64] = (hertz + ratios[..., None] * bond).min(axis=-1)
        return lengths


def path_envelope(
    graph: ContactGraph, bonded: ArrayLike, low: float = 0.01, high: float = 0.99
) -> PathEnvelope:
    """Find the envelope of one sample.

    Parameters
    ----------
    graph
        The contacts of the packing.
    bonded
        Which of them are cemented, booleans, shape (m,).
    low, high
        Range of the ratio, 0 < low < high <= 1.

    Raises
    ------
    ValueError
        If the range is empty or outside (0, 1], or no chain of contacts joins transmitter and receiver.

    Notes
    -----
    Eisner and Severance (1976), doi:10.1145/321978.321982: find the shortest paths at both ends of the range
    and cut their lines; at the cut search again. A path shorter there is a new line, and both halves are
    treated alike; if there is none, the cut is a corner. k lines take at most 2 k searches or so, and
    comparing them needs only integers.
    """
    if not 0 < low < high <= 1:
        raise ValueError(f"low = {low} and high = {high}; they must satisfy 0 < low < high <= 1")
    mask = np.asarray(bonded, dtype=np.bool_)

    def shortest(ratio: float) -> PathLine:
        path = preferential_path(graph, mask, ContactWeights.from_ratio(ratio))
        return PathLine(path.hertz_contacts, path.bond_contacts)

    def between(left: PathLine, right: PathLine) -> list[PathLine]:
        rise = right.hertz_contacts - left.hertz_contacts
        run = left.bond_contacts - right.bond_contacts
        if run <= 0 or not low < rise / run < high:
            return []  # equal lines, or lines that only tie at an end of the range
        middle = shortest(rise / run)
        # Lengths times `run` at the cut, in integers: is the new path strictly shorter?
        gain = run * (left.hertz_contacts - middle.hertz_contacts) + rise * (
            left.bond_contacts - middle.bond_contacts
        )
        return [*between(left, middle), middle, *between(middle, right)] if gain > 0 else []

    first, last = shortest(low), shortest(high)
    lines = [first, *between(first, last), last]
    return PathEnvelope(tuple(dict.fromkeys(lines)), low, high)
