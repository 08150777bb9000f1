"""Shortest paths for all ratios of the two weights at once.

With omega_h = 1 and r = omega_LPB / omega_h, a path of N_h sand and N_LPB cemented contacts has length N_h +
r N_LPB, a straight line over r. The length of the shortest path is the lower envelope of these lines, which has
few corners. A few searches therefore give the exact envelope of a sample for all ratios.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.connectivity import ContactWeights
from calcidem.analysis.contact_graph import ContactGraph, contacts_on_path


class PathLine(NamedTuple):
    """Numbers of contacts on a path, which define the line N_h + r N_LPB over the ratio r."""

    hertz_contacts: int
    bonded_contacts: int
    """Sand contacts N_h and cemented contacts N_LPB."""


@dataclass(frozen=True, slots=True)
class PathEnvelope:
    """Shortest path length of one sample over the weight ratio."""

    lines: tuple[PathLine, ...]
    """Paths that are shortest at some ratio, in order of the ratio: N_LPB falls and N_h grows from each to the next."""
    low: float
    high: float
    """Range of ratios of the envelope."""

    def connectivity(self, ratio: ArrayLike) -> NDArray[np.float64]:
        """Return C_d for omega_h = 1 and these omega_LPB, any shape; `ValueError` outside of `low` and `high`."""
        ratios = np.asarray(ratio, dtype=np.float64)
        if ratios.size and not (self.low <= ratios.min() and ratios.max() <= self.high):
            raise ValueError(
                f"ratio spans {ratios.min()} to {ratios.max()}, the envelope {self.low} to {self.high}; "
                "find the envelope over a wider range"
            )
        hertz, bond = np.array(self.lines, dtype=np.float64).T
        lengths: NDArray[np.float64] = (hertz + ratios[..., None] * bond).min(axis=-1)
        return lengths


def path_envelope(graph: ContactGraph, bonded: ArrayLike, low: float = 0.01, high: float = 0.99) -> PathEnvelope:
    """Return the envelope of one sample with cemented contacts ``bonded`` (m,), for 0 < low < high <= 1.

    `ValueError` for another range, or if no chain of contacts joins transmitter and receiver.

    Eisner and Severance (1976), doi:10.1145/321978.321982: find the shortest paths at both ends of the range and
    intersect their lines, then search at the intersection. A shorter path there is a new line, and both halves are
    treated alike; otherwise the intersection is a corner. k lines take at most about 2 k searches, and their comparison
    needs only integers.
    """
    if not 0 < low < high <= 1:
        raise ValueError(f"low = {low} and high = {high}; they must satisfy 0 < low < high <= 1")
    mask = np.asarray(bonded, dtype=np.bool_)

    def shortest(ratio: float, known: PathLine | None = None) -> PathLine:
        weights = ContactWeights.from_ratio(ratio)
        at_most = (
            np.inf if known is None else known.hertz_contacts * weights.hertz + known.bonded_contacts * weights.bond
        )
        return PathLine(*contacts_on_path(graph, mask, weights, at_most))

    def between(left: PathLine, right: PathLine) -> list[PathLine]:
        if left == right or not low < _corner(left, right) < high:
            return []
        middle = shortest(_corner(left, right), left)
        if not _shorter_at_corner(middle, left, right):
            return []
        return [*between(left, middle), middle, *between(middle, right)]

    last = shortest(high)
    first = shortest(low, last)
    found = list(dict.fromkeys([first, *between(first, last), last]))
    return PathEnvelope(_strictly_shortest(found, low, high), low, high)


def _strictly_shortest(found: list[PathLine], low: float, high: float) -> tuple[PathLine, ...]:
    """Drop the lines that only touch the envelope, at a corner or at an end of the range.

    A search there may return any of the tied paths. Equal corners are equal numbers, since each is the quotient of two
    integers, rounded once.
    """
    lines: list[PathLine] = []
    for line in found:
        while lines and _corner(lines[-1], line) <= (_corner(lines[-2], lines[-1]) if len(lines) > 1 else low):
            lines.pop()
        if not lines or _corner(lines[-1], line) < high:
            lines.append(line)
    return tuple(lines)


def _corner(before: PathLine, after: PathLine) -> float:
    """Return the ratio at which two different lines intersect."""
    return (after.hertz_contacts - before.hertz_contacts) / (before.bonded_contacts - after.bonded_contacts)


def _shorter_at_corner(middle: PathLine, left: PathLine, right: PathLine) -> bool:
    """Return whether `middle` is strictly shorter where the others intersect; in integers, without round-off."""
    rise = right.hertz_contacts - left.hertz_contacts
    run = left.bonded_contacts - right.bonded_contacts
    hertz_gain = left.hertz_contacts - middle.hertz_contacts
    bond_gain = left.bonded_contacts - middle.bonded_contacts
    return run * hertz_gain + rise * bond_gain > 0
