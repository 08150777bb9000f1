"""Ratio of the contact weights with the best correlation of C_d,n and Vs (Fig. 14 of the paper)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.intervals import BOOTSTRAP_SEED, Interval
from calcidem.analysis.path_envelope import PathEnvelope

_SMALLEST_SAMPLE = 3
"""Fewest samples: two always lie on a line, so their correlation has no meaning."""

_CORRELATION_TIE = 1e-6
"""Difference below which correlations are equal."""

_WEIGHT_RATIOS = np.linspace(0.01, 0.99, 99)
"""Ratios of the scan, without 1, where cement makes no difference and C_d,n is undefined."""
_WEIGHT_RATIOS.flags.writeable = False


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
    ratios: ArrayLike = _WEIGHT_RATIOS,
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
        Ratios to compare, shape (k,), ascending, at least two.
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
    grid = np.asarray(ratios, dtype=np.float64)
    if velocity.ndim != 1 or not len(envelopes) == velocity.size == seeds.size:
        raise ValueError(
            f"got {len(envelopes)} envelopes, vs of shape {velocity.shape} and seed of shape {seeds.shape}; "
            "give one of each for every sample"
        )
    known = np.isfinite(velocity)
    if known.sum() < _SMALLEST_SAMPLE:
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
    return np.asarray(np.argmax(correlation <= best + _CORRELATION_TIE, axis=1))


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
