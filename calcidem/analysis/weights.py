"""Which ratio of the contact weights makes C_d,n tell most about Vs (Fig. 14 of the paper)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.intervals import BOOTSTRAP_SEED, Interval
from calcidem.analysis.path_envelope import PathEnvelope

_SMALLEST_SAMPLE = 3
"""Two samples always lie on a line, so a correlation has no meaning."""

_CORRELATION_TIE = 1e-6
"""Correlations closer than this are taken for equal."""

_WEIGHT_RATIOS = np.linspace(0.01, 0.99, 99)
"""The ratios of the scan. The value 1 is left out: there cement makes no difference and C_d,n is
undefined."""
_WEIGHT_RATIOS.flags.writeable = False


@dataclass(frozen=True, slots=True, eq=False)
class RatioScan:
    """Correlation of C_d,n with Vs over the weight ratio.

    Attributes
    ----------
    ratios
        omega_LPB / omega_h, shape (k,).
    correlation
        Pearson's coefficient at each, shape (k,); NaN where C_d,n is the same for all samples.
    best_ratio
        Where it is most negative.
    best_correlation
        Its value there.
    best_ratio_interval
        Interval with the best ratio of 95 % of the bootstrap replicates (or of another level).
    n
        Number of samples used.
    left_out
        Number of samples without velocity.
    """

    ratios: NDArray[np.float64]
    correlation: NDArray[np.float64]
    best_ratio: float
    best_correlation: float
    best_ratio_interval: Interval
    n: int
    left_out: int


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
        One of each for every sample: its shortest path for all ratios, its velocity in m/s (NaN for none), and
        its seed.
    ratios
        Ratios to compare, shape (k,), ascending, at least two.
    level, replicates
        Of the interval, and bootstrap replicates.

    Notes
    -----
    At one ratio C_d,n is C_d shifted and divided by constants (Eq. 9), so both have the same correlation with Vs and
    C_d is used, which stays finite near a ratio of 1.

    The bootstrap draws seeds, with all contents of a seed, since samples of one seed share their cement from content to
    content and are not independent (Davison and Hinkley 1997, section 3.8).
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
    # A replicate of one seed drawn repeatedly may have no correlation at all; it is left out.
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
    """Place of the smallest ratio that correlates as well as the best one, in each row of shape (replicates, ratios).

    From some ratio on the shortest paths no longer change, and with them neither does the correlation. The scan then
    ends in a plateau on which round-off alone would choose, while C_d,n grows without limit.
    """
    best = np.nanmin(correlation, axis=1, keepdims=True)
    return np.asarray(np.argmax(correlation <= best + _CORRELATION_TIE, axis=1))


def _sums_by_seed(
    lengths: NDArray[np.float64], vs: NDArray[np.float64], seeds: NDArray[np.generic]
) -> NDArray[np.float64]:
    """Add up n, x, y, x^2, y^2 and x y over the samples of each seed: all that Pearson's coefficient needs.

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
    # What is left of a variance after cancellation is no variance.
    constant = (variance_x <= 1e-12 * n) | (variance_y <= 1e-12 * n)
    with np.errstate(divide="ignore", invalid="ignore"):
        coefficient = (xy - x * y / n) / np.sqrt(variance_x * variance_y)
    return np.where(constant, np.nan, coefficient)
