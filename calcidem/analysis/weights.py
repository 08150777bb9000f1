"""Shortest paths at all ratios of the contact weights, and the ratio that correlates best (Fig. 14 of the paper)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.connectivity import ContactWeights
from calcidem.analysis.contact_graph import ContactGraph, contacts_on_path
from calcidem.analysis.intervals import BOOTSTRAP_SEED, Interval


class _PathLine(NamedTuple):
    """Numbers of contacts on a path, which define the line N_h + r N_LPB over the ratio r."""

    hertz_contacts: int
    bonded_contacts: int
    """Sand contacts N_h and cemented contacts N_LPB."""


@dataclass(frozen=True, slots=True)
class PathEnvelope:
    """Shortest path length of one sample over the weight ratio."""

    lines: tuple[_PathLine, ...]
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

    def shortest(ratio: float, known: _PathLine | None = None) -> _PathLine:
        weights = ContactWeights.from_ratio(ratio)
        at_most = (
            np.inf if known is None else known.hertz_contacts * weights.hertz + known.bonded_contacts * weights.bond
        )
        return _PathLine(*contacts_on_path(graph, mask, weights, at_most))

    def between(left: _PathLine, right: _PathLine) -> list[_PathLine]:
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


def _strictly_shortest(found: list[_PathLine], low: float, high: float) -> tuple[_PathLine, ...]:
    """Drop the lines that only touch the envelope, at a corner or at an end of the range.

    A search there may return any of the tied paths. Equal corners are equal numbers, since each is the quotient of two
    integers, rounded once.
    """
    lines: list[_PathLine] = []
    for line in found:
        while lines and _corner(lines[-1], line) <= (_corner(lines[-2], lines[-1]) if len(lines) > 1 else low):
            lines.pop()
        if not lines or _corner(lines[-1], line) < high:
            lines.append(line)
    return tuple(lines)


def _corner(before: _PathLine, after: _PathLine) -> float:
    """Return the ratio at which two different lines intersect."""
    return (after.hertz_contacts - before.hertz_contacts) / (before.bonded_contacts - after.bonded_contacts)


def _shorter_at_corner(middle: _PathLine, left: _PathLine, right: _PathLine) -> bool:
    """Return whether `middle` is strictly shorter where the others intersect; in integers, without round-off."""
    rise = right.hertz_contacts - left.hertz_contacts
    run = left.bonded_contacts - right.bonded_contacts
    hertz_gain = left.hertz_contacts - middle.hertz_contacts
    bond_gain = left.bonded_contacts - middle.bonded_contacts
    return run * hertz_gain + rise * bond_gain > 0


@dataclass(frozen=True, slots=True, eq=False)
class RatioScan:
    """Correlation of C_d,n with Vs over the weight ratio."""

    ratios: NDArray[np.float64]
    """omega_LPB / omega_h, shape (k,)."""
    correlation: NDArray[np.float64]
    """Pearson's coefficient at each ratio, shape (k,); NaN if C_d,n is the same for all samples."""
    best_ratio: float
    """Ratio of the most negative coefficient."""
    best_correlation: float
    """Coefficient at the best ratio."""
    best_ratio_interval: Interval
    """Bootstrap interval of the best ratio, by default at 95 %."""
    n: int
    """Number of samples used."""
    left_out: int
    """Number of samples without velocity."""


def scan_ratio(
    envelopes: Sequence[PathEnvelope],
    vs: ArrayLike,
    seed: ArrayLike,
    *,
    ratios: ArrayLike | None = None,
    level: float = 0.95,
    replicates: int = 2000,
) -> RatioScan:
    """Scan the weight ratio, with a new search for the shortest path of every sample at every ratio.

    `ValueError` if shapes disagree, fewer than three samples have a velocity, or no ratio has a correlation.

    Parameters
    ----------
    envelopes, vs, seed
        For every sample its shortest path for all ratios, its velocity in m/s (NaN if missing), and its seed.
    ratios
        Ratios to compare, shape (k,), ascending, at least two, below 1; 0.01 to 0.99 by default.
    level, replicates
        Level of the interval, and number of bootstrap replicates.

    Notes
    -----
    At one ratio C_d,n is a linear function of C_d (Eq. 9), so both have the same correlation with Vs. C_d is used
    because it stays finite near a ratio of 1.

    The bootstrap draws seeds with all their contents, since samples of one seed share their cement and are not
    independent (Davison and Hinkley 1997, section 3.8).
    """
    velocity, seeds = np.asarray(vs, dtype=np.float64), np.asarray(seed)
    grid = np.linspace(0.01, 0.99, 99) if ratios is None else np.asarray(ratios, dtype=np.float64)
    if velocity.ndim != 1 or not len(envelopes) == velocity.size == seeds.size:
        raise ValueError(
            f"got {len(envelopes)} envelopes, vs of shape {velocity.shape} and seed of shape {seeds.shape}; "
            "give one of each for every sample"
        )
    known = np.isfinite(velocity)
    if known.sum() < 3:  # two always lie on a line
        raise ValueError(f"only {known.sum()} samples have a velocity; a correlation needs at least three")
    lengths = np.stack([envelope.connectivity(grid) for envelope, use in zip(envelopes, known, strict=True) if use])
    sums = _sums_by_seed(lengths, velocity[known], seeds[known])
    seed_count = sums.shape[0]
    correlation = _correlate_sums(np.ones((1, seed_count)), sums)[0]
    if np.isnan(correlation).all():
        raise ValueError("no ratio has a correlation: all samples have the same path or the same velocity")
    best = int(_first_best(correlation[None])[0])
    generator = np.random.default_rng(BOOTSTRAP_SEED)
    draws = generator.multinomial(seed_count, np.full(seed_count, 1 / seed_count), size=replicates)
    drawn = _correlate_sums(draws.astype(np.float64), sums)
    # A replicate with a single seed may have no correlation; it is left out.
    usable = drawn[~np.isnan(drawn).all(axis=1)]
    best_ratios = grid[_first_best(usable)]
    low, high = np.quantile(best_ratios, [(1 - level) / 2, (1 + level) / 2])
    return RatioScan(
        ratios=grid,
        correlation=correlation,
        best_ratio=float(grid[best]),
        best_correlation=float(correlation[best]),
        best_ratio_interval=Interval(float(low), float(high)),
        n=int(known.sum()),
        left_out=int((~known).sum()),
    )


def _first_best(correlation: NDArray[np.float64]) -> NDArray[np.intp]:
    """Index of the smallest ratio that correlates as well as the best one, in each row of shape (replicates, ratios).

    Above some ratio the shortest paths, and with them the correlation, no longer change. On this plateau round-off
    would decide, while C_d,n grows without limit.
    """
    best = np.nanmin(correlation, axis=1, keepdims=True)
    return np.asarray(np.argmax(correlation <= best + 1e-6, axis=1))


def _sums_by_seed(
    lengths: NDArray[np.float64], vs: NDArray[np.float64], seeds: NDArray[np.generic]
) -> NDArray[np.float64]:
    """Sum n, x, y, x^2, y^2 and x y over the samples of each seed, as needed for Pearson's coefficient.

    Shape (seeds, 6, ratios). Values are centred first, since sums of squares of large numbers lose digits.
    """
    x = lengths - lengths.mean(axis=0)
    y = np.broadcast_to((vs - vs.mean())[:, None], x.shape)
    terms = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], axis=1)
    names, rows = np.unique(seeds, return_inverse=True)
    sums = np.zeros((names.size, *terms.shape[1:]))
    np.add.at(sums, rows, terms)
    return sums


def _correlate_sums(multiplicity: NDArray[np.float64], sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pearson's coefficient when each seed counts `multiplicity` times; shape (replicates, ratios)."""
    n, x, y, xx, yy, xy = np.moveaxis(np.tensordot(multiplicity, sums, axes=1), 1, 0)
    variance_x, variance_y = xx - x * x / n, yy - y * y / n
    # Cancellation leaves round-off instead of a variance.
    constant = (variance_x <= 1e-12 * n) | (variance_y <= 1e-12 * n)
    with np.errstate(divide="ignore", invalid="ignore"):
        coefficient = (xy - x * y / n) / np.sqrt(variance_x * variance_y)
    return np.where(constant, np.nan, coefficient)
