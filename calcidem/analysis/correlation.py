"""Correlation of path features with Vs (Fig. 13a), and the ratio of contact weights that correlates best (Fig. 14).

Features and Vs both grow with calcite content, so over all contents they correlate strongly for any paths. The
scatter explained by a feature at a fixed content is a separate, harder question. This module answers both. Within a
content each variable is divided by its scatter there; otherwise contents with large Vs would dominate.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from calcidem.analysis.intervals import BOOTSTRAP_SEED, Interval
from calcidem.analysis.packing_graph import ContactGraph, ContactWeights, connectivity, contacts_on_path

_ROUND_OFF = 1e-12
"""Relative size below which variation and differences of coefficients are round-off."""

_RATIOS = np.linspace(0.01, 0.99, 99)
"""Compared ratios of contact weights."""


@dataclass(frozen=True, slots=True, eq=False)
class Correlations:
    """Correlation matrices of one table of variables.

    Each is a Dataset along (variable, other) with `pearson`, its interval `pearson_low` and `pearson_high`,
    `spearman`, and the number of samples `n`. Constant variables have NaN.
    """

    overall: xr.Dataset
    """Over all samples of all contents. A common trend with content inflates it."""
    within: xr.Dataset
    """Over deviations from the trend: each variable minus its mean at the content, divided by its standard deviation
    there. Spearman's coefficient takes ranks within the content. Two variables are compared at the contents where both
    vary.
    """


def correlate(table: xr.Dataset) -> Correlations:
    """Correlate all variables of a table with one another.

    The table has numbers along (seed, content), NaN if missing; only complete samples count. `ValueError` for other
    dimensions.

    Intervals of 95 % by Fisher's z, tanh(artanh(r) -/+ z / sqrt(n - 3)), with one degree of freedom less for each
    further content whose mean was subtracted (Fisher 1924, on partial correlation). They assume independent samples.
    Samples of one seed share their cement, so the intervals are too narrow; `seed_permutation_test` has others.
    """
    names, values = _complete_values(table)
    complete = np.isfinite(values[..., 0])
    groups = [values[complete[:, column], column] for column in range(values.shape[1]) if complete[:, column].any()]
    pooled = [np.concatenate(groups)] if groups else []
    return Correlations(*(_correlation_matrix(parts, names) for parts in (pooled, groups)))


def seed_permutation_test(table: xr.Dataset, target: str) -> xr.Dataset:
    """Test which variables of a table correlate with the target variable within one content.

    Table and errors are as for `correlate`; also `ValueError` if the table lacks the target. Returns along variable,
    without the target: ``pearson`` of `correlate` within one content, its 95 % interval ``pearson_low`` and
    ``pearson_high``, its two-sided ``p``, and ``p_corrected``, the probability that the largest of all
    coefficients is as large by chance. NaN for constant variables; where an order of the seeds gives a coefficient of
    1, there is no interval, nor with fewer than 4 seeds, whose few orders scatter by too little.

    Intervals are those of Fisher's z, with its standard deviation over the permutations: between seeds that share
    effects it is larger than that of as many independent samples.

    Rows of whole seeds are permuted at random against those of the target, since samples of one seed are not
    independent. A missing sample counts as the mean of its content. The correction uses the largest statistic (Westfall
    and Young 1993, doi:10.2307/2532216) and does not assume any dependence of the variables.
    """
    names, values = _complete_values(table)
    place = names.index(target)
    values = values[np.isfinite(values).any(axis=(1, 2))]  # seeds without data are not permuted
    known: NDArray[np.bool_] = np.asarray(np.isfinite(values).any(axis=-1))
    standard = np.zeros(values.shape)
    for column in np.flatnonzero(known.any(axis=0)).tolist():  # contents without a velocity have no correlation
        standard[known[:, column], column] = np.nan_to_num(_standardised(values[known[:, column], column]))
    others = [number for number in range(len(names)) if number != place]
    features, targets = standard[..., others], standard[..., place]
    features[:, ~targets.any(axis=0)] = 0.0  # where the target does not vary, features correlate with nothing
    squares = (targets * targets).sum(axis=0) @ features.any(axis=0)  # where the feature varies
    scale = np.sqrt(squares * (features * features).sum(axis=(0, 1)))
    features = (features / np.where(scale > 0, scale, np.nan)).reshape(-1, len(others))
    observed, count = targets.ravel() @ features, 9999
    random, drawn = np.random.default_rng(BOOTSTRAP_SEED), np.empty((count, len(others)))
    for begin in range(0, count, 99):  # at once, to bound the memory
        shuffled = np.empty((99, *targets.shape))
        for one in shuffled:
            one[random.permutation(len(targets))] = targets
        drawn[begin : begin + 99] = shuffled.reshape(99, -1) @ features
    size, sizes = np.abs(observed) - _ROUND_OFF, np.abs(drawn)
    z = np.arctanh(np.where(sizes < 1.0 - _ROUND_OFF, drawn, np.nan))
    half = float(stats.norm.ppf(0.975)) * z.std(axis=0) if len(targets) >= 4 else math.nan
    centre = np.arctanh(np.where(size < 1.0 - 2.0 * _ROUND_OFF, observed, np.nan))
    largest = np.where(np.isfinite(sizes), sizes, 0.0).max(axis=1)

    def share(as_large: NDArray[np.bool_]) -> NDArray[np.float64]:
        found = (1 + as_large.sum(axis=0)) / (1 + count)
        return np.where(np.isfinite(observed), found, np.nan)

    return xr.Dataset(
        {
            "pearson": ("variable", observed),
            "pearson_low": ("variable", np.tanh(centre - half)),
            "pearson_high": ("variable", np.tanh(centre + half)),
            "p": ("variable", share(sizes >= size)),
            "p_corrected": ("variable", share(largest[:, None] >= size)),
        },
        coords={"variable": [names[number] for number in others]},
    )


def _complete_values(table: xr.Dataset) -> tuple[list[str], NDArray[np.float64]]:
    """Names of the variables of a table and values (seed, content, variable); NaN in all if one is missing."""
    names = [str(name) for name in table.data_vars]
    values = np.stack([table[name].transpose("seed", "content").to_numpy() for name in names], axis=-1).astype(
        np.float64
    )
    return names, np.where(np.isfinite(values).all(axis=-1, keepdims=True), values, np.nan)


def _correlation_matrix(groups: Sequence[NDArray[np.float64]], names: list[str]) -> xr.Dataset:
    """Correlation matrix of samples in groups (n, variables), each variable relative to its mean in the group.

    With three or fewer samples less those lost to means, Fisher's interval is NaN.
    """
    pearson, count, lost = _pearson_matrix(groups, len(names))
    spearman, *_ = _pearson_matrix([stats.rankdata(group, axis=0) for group in groups], len(names))
    freedom = count - lost - 3.0
    half = float(stats.norm.ppf(0.975)) / np.sqrt(np.where(freedom > 0.0, freedom, np.nan))
    with np.errstate(divide="ignore"):  # a coefficient of one has an infinite z, and tanh returns one
        z = np.arctanh(pearson)
    square = ("variable", "other")
    return xr.Dataset(
        {
            "pearson": (square, pearson),
            "pearson_low": (square, np.tanh(z - half)),
            "pearson_high": (square, np.tanh(z + half)),
            "spearman": (square, spearman),
            "n": int(count.max(initial=0)),  # those that vary
        },
        coords={"variable": names, "other": names},
        attrs={"level": 0.95},
    )


def _pearson_matrix(
    groups: Sequence[NDArray[np.float64]], size: int
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Pearson's matrix of variables in groups, NaN for constant ones; numbers of samples, and of groups less one.

    A pair of variables counts in the groups in which both vary.
    """
    total, count, lost = np.zeros((size, size)), np.zeros((size, size), np.int64), np.full((size, size), -1)
    for group in groups:
        scaled = _standardised(group)
        varied = np.isfinite(scaled).all(axis=0)
        both = np.outer(varied, varied)
        scaled = np.nan_to_num(scaled)
        total, count, lost = total + scaled.T @ scaled, count + len(group) * both, lost + both
    with np.errstate(divide="ignore", invalid="ignore"):
        matrix = np.where(count > 1, np.clip(total / count, -1.0, 1.0), np.nan)
    np.fill_diagonal(matrix, np.where(np.isnan(np.diag(matrix)), np.nan, 1.0))
    return matrix, count, np.maximum(lost, 0)


def _standardised(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standardised samples (n, variables): zero mean, unit deviation; NaN for constant columns."""
    centred = samples - samples.mean(axis=0)
    scale = centred.std(axis=0)
    constant = scale <= _ROUND_OFF * np.abs(samples).max(axis=0)
    return np.asarray(centred / np.where(constant, np.nan, scale))


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

    def connectivity(self, ratio: ArrayLike) -> NDArray[np.float64]:
        """Return C_d for omega_h = 1 and these omega_LPB within `_RATIOS`, any shape."""
        ratios = np.asarray(ratio, dtype=np.float64)
        hertz, bond = np.array(self.lines, dtype=np.float64).T
        lengths: NDArray[np.float64] = (hertz + ratios[..., None] * bond).min(axis=-1)
        return lengths


def path_envelope(graph: ContactGraph, bonded: ArrayLike) -> PathEnvelope:
    """Return the envelope of one sample with cemented contacts ``bonded`` (m,).

    `ValueError` if no chain of contacts joins transmitter and receiver.

    Eisner and Severance (1976), doi:10.1145/321978.321982: find the shortest paths at both ends of the range and
    intersect their lines, then search at the intersection. A shorter path there is a new line, and both halves are
    treated alike; otherwise the intersection is a corner. k lines take at most about 2 k searches, and their comparison
    needs only integers.
    """
    low, high = float(_RATIOS[0]), float(_RATIOS[-1])
    mask = np.asarray(bonded, dtype=np.bool_)

    def shortest(ratio: float, known: _PathLine | None = None) -> _PathLine:
        weights = ContactWeights.from_ratio(ratio)
        at_most = np.inf if known is None else connectivity(*known, weights)
        return _PathLine(*contacts_on_path(graph, mask, weights, at_most))

    def between(left: _PathLine, right: _PathLine) -> list[_PathLine]:
        if left == right or not low < _corner(left, right) < high:
            return []
        middle = shortest(_corner(left, right), left)
        # It must be strictly shorter where the others intersect: in integers, without round-off.
        rise, run = right.hertz_contacts - left.hertz_contacts, left.bonded_contacts - right.bonded_contacts
        hertz_gain = left.hertz_contacts - middle.hertz_contacts
        bond_gain = left.bonded_contacts - middle.bonded_contacts
        if run * hertz_gain + rise * bond_gain <= 0:
            return []
        return [*between(left, middle), middle, *between(middle, right)]

    last = shortest(high)
    first = shortest(low, last)
    found = list(dict.fromkeys([first, *between(first, last), last]))
    return PathEnvelope(_strictly_shortest(found, low, high))


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
    """Bootstrap interval of the best ratio, 95 %."""


def scan_ratio(envelopes: Sequence[PathEnvelope], vs: ArrayLike, seed: ArrayLike) -> RatioScan:
    """Scan the weight ratio, with a new search for the shortest path of every sample at every ratio.

    `ValueError` if fewer than three samples have a velocity, or no ratio has a correlation.

    Parameters
    ----------
    envelopes, vs, seed
        For every sample its shortest path for all ratios, its velocity in m/s (NaN if missing), and its seed.

    Notes
    -----
    At one ratio C_d,n is a linear function of C_d (Eq. 9), so both have the same correlation with Vs. C_d is used
    because it stays finite near a ratio of 1.

    The bootstrap draws seeds with all their contents, since samples of one seed share their cement and are not
    independent (Davison and Hinkley 1997, section 3.8).
    """
    velocity, seeds = np.asarray(vs, dtype=np.float64), np.asarray(seed)
    known = np.isfinite(velocity)
    if known.sum() < 3:  # two always lie on a line
        raise ValueError(f"only {known.sum()} samples have a velocity; a correlation needs at least three")
    lengths = np.stack([envelope.connectivity(_RATIOS) for envelope, use in zip(envelopes, known, strict=True) if use])
    sums = _sums_by_seed(lengths, velocity[known], seeds[known])
    seed_count = sums.shape[0]
    correlation = _correlate_sums(np.ones((1, seed_count)), sums)[0]
    if np.isnan(correlation).all():
        raise ValueError("no ratio has a correlation: all samples have the same path or the same velocity")
    best = int(_first_best(correlation[None])[0])
    generator = np.random.default_rng(BOOTSTRAP_SEED)
    draws = generator.multinomial(seed_count, np.full(seed_count, 1 / seed_count), size=2000)
    drawn = _correlate_sums(draws.astype(np.float64), sums)
    # A replicate with a single seed may have no correlation; it is left out.
    usable = drawn[~np.isnan(drawn).all(axis=1)]
    best_ratios = _RATIOS[_first_best(usable)]
    low, high = np.quantile(best_ratios, [0.025, 0.975])
    return RatioScan(
        ratios=_RATIOS,
        correlation=correlation,
        best_ratio=float(_RATIOS[best]),
        best_correlation=float(correlation[best]),
        best_ratio_interval=Interval(float(low), float(high)),
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
