import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from calcidem.analysis.correlation import (
    PathEnvelope,
    _correlate_sums,
    _first_best,
    _PathLine,
    _sums_by_seed,
    scan_ratio,
)
from calcidem.analysis.packing_graph import ContactWeights, normalized_connectivity

SEEDS, CONTENTS = 20, 6


def campaign(
    true_ratio: float, noise: float, random: int = 0
) -> tuple[list[PathEnvelope], NDArray[np.float64], NDArray[np.int64]]:
    """Make samples whose velocity falls with the path length that one true ratio gives, plus noise in m/s."""
    generator = np.random.default_rng(random)
    envelopes, velocity = [], []
    for _ in range(SEEDS * CONTENTS):
        hertz, bond = (int(count) for count in generator.integers(1, 30, size=2))
        envelopes.append(PathEnvelope((_PathLine(hertz, bond),)))
        velocity.append(2500 - 40 * (hertz + true_ratio * bond) + generator.normal(0, noise))
    return envelopes, np.array(velocity), np.repeat(np.arange(SEEDS), CONTENTS)


def test_the_true_ratio_is_found_when_there_is_no_noise() -> None:
    """Velocities that fall linearly with the path length of ratio 0.6 have a correlation of -1 there."""
    scan = scan_ratio(*campaign(0.6, 0.0))
    assert scan.best_ratio == pytest.approx(0.6)
    assert scan.best_correlation == pytest.approx(-1.0)
    assert scan.best_ratio_interval.half_width == pytest.approx(0.0)
    assert scan.ratios[0] < scan.best_ratio < scan.ratios[-1]


def test_the_interval_holds_the_true_ratio_as_often_as_promised() -> None:
    """Of 100 noisy campaigns, most have the true ratio in their interval.

    Binomial error is 2.2 points; a percentile bootstrap of 20 seeds is known to fall short by a few points
    more.
    """
    hits = 0
    for trial in range(100):
        envelopes, velocity, seeds = campaign(0.6, 100.0, trial)
        scan = scan_ratio(envelopes, velocity, seeds)
        hits += scan.best_ratio_interval.contains(0.6)
    assert 86 <= hits <= 100


def test_correlation_is_that_of_normalised_connectivity() -> None:
    """At each ratio the coefficient is SciPy's, between C_d,n itself and Vs."""
    envelopes, velocity, seeds = campaign(0.6, 100.0)
    scan = scan_ratio(envelopes, velocity, seeds)
    straight = 0.1 / 2.56e-3 - 1
    for place in (29, 82):
        ratio, found = scan.ratios[place], scan.correlation[place]
        weights = ContactWeights.from_ratio(ratio)
        lengths = [float(envelope.connectivity(ratio)) for envelope in envelopes]
        c_dn = [normalized_connectivity(length, weights, straight) for length in lengths]
        assert found == pytest.approx(stats.pearsonr(c_dn, velocity).statistic)


def test_a_replicate_counts_a_seed_as_often_as_it_was_drawn() -> None:
    """The coefficient from sums of seeds is SciPy's on samples repeated by hand."""
    envelopes, velocity, seeds = campaign(0.6, 100.0)
    lengths = np.array([envelope.connectivity(0.4) for envelope in envelopes])
    times = np.random.default_rng(1).integers(0, 4, SEEDS)
    found = _correlate_sums(times[None].astype(float), _sums_by_seed(lengths[:, None], velocity, seeds))
    expected = stats.pearsonr(np.repeat(lengths, times[seeds]), np.repeat(velocity, times[seeds])).statistic
    assert found[0, 0] == pytest.approx(expected)


def test_more_noise_widens_the_interval() -> None:
    """The best ratio is less certain when velocities scatter more."""
    quiet, loud = (scan_ratio(*campaign(0.6, noise)).best_ratio_interval.half_width for noise in (30.0, 200.0))
    assert loud > 2 * quiet


def test_samples_without_velocity_are_left_out_and_counted() -> None:
    """Gaps change nothing but the count, if the others are the same."""
    envelopes, velocity, seeds = campaign(0.6, 100.0)
    gaps = velocity.copy()
    gaps[::7] = np.nan
    known = np.isfinite(gaps)
    scan = scan_ratio(envelopes, gaps, seeds)
    kept = [envelope for envelope, keep in zip(envelopes, known, strict=True) if keep]
    expected = scan_ratio(kept, velocity[known], seeds[known])
    np.testing.assert_allclose(scan.correlation, expected.correlation)


def test_a_true_ratio_beyond_the_scan_gives_its_edge() -> None:
    """If the true ratio lies beyond the scan, the best one is at its edge."""
    assert scan_ratio(*campaign(1.5, 0.0)).best_ratio == pytest.approx(0.99)


def test_the_smallest_of_a_plateau_is_best() -> None:
    """Where the correlation no longer changes, round-off does not choose the ratio."""
    rows = np.array([[-0.80, -0.84, -0.84, -0.84 - 1e-15], [np.nan, -0.5, -0.6, -0.55]])
    assert _first_best(rows).tolist() == [1, 2]


def test_samples_that_are_all_alike_are_refused() -> None:
    """Where every sample has the same path there is nothing to correlate."""
    envelopes, velocity, seeds = campaign(0.6, 100.0)
    with pytest.raises(ValueError, match="same path"):
        scan_ratio([envelopes[0]] * len(envelopes), velocity, seeds)


def test_too_few_velocities_are_refused() -> None:
    """There are three at least."""
    envelopes, velocity, seeds = campaign(0.6, 100.0)
    with pytest.raises(ValueError, match="at least three"):
        scan_ratio(envelopes, np.where(np.arange(velocity.size) < 2, velocity, np.nan), seeds)
    three = np.where(np.arange(velocity.size) % 4 == 0, velocity, np.nan)
    three[np.flatnonzero(np.isfinite(three))[3:]] = np.nan
    assert np.isfinite(scan_ratio(envelopes, three, seeds).best_correlation)
