"""Patches of P or a timing error: `python docs/reproduction/rival.py PAPER.db SMALL_PULSE.db [FIGURE.png]`.

The second campaign is of `paper-small-pulse`, whose P contacts are single. An error of 25 microseconds is added to each
of its travel times, independent of everything. To first order the relative variance of Vs then grows by
(error x Vs / distance)^2. In the paper's Table 3 the standard deviation of the travel time is distance x sd / mean^2.
"""

import argparse
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from calcidem.analysis.figures.style import BLUE, CONTENT_LABEL, GREEN, GREY, VERMILION, apply_style, new_figure
from calcidem.analysis.published import published_study
from calcidem.app.campaign.opened import open_campaign

ERROR = 25e-6  # s
DISTANCE = 0.1  # m, of the paper
P_ALONE = 0.7  # percent; no clusters below


def main() -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("paper")
    parser.add_argument("small_pulse")
    parser.add_argument("figure", nargs="?")
    given = parser.parse_args()
    rows = published_study().velocities
    contents = np.array([content for content, _ in rows])
    means, deviations = np.array([(row.mean, row.standard_deviation) for _, row in rows]).T
    published = DISTANCE * deviations / means**2
    both = patches, single = tuple(travel_times(database, contents) for database in (given.paper, given.small_pulse))
    own_time, other_time = (np.nanstd(times, axis=0, ddof=1) for times in both)
    with_error = np.hypot(other_time, ERROR)
    print("| % | sd of the travel time, microseconds: paper | patches | single P | single P and 25 microseconds |")
    print("|---|---|---|---|---|")
    for row in zip(contents, published, own_time, other_time, with_error, strict=True):
        print(f"| {row[0]:g} | {' | '.join(f'{1e6 * value:.1f}' for value in row[1:])} |")
    print("\n| % | sd / mean over the paper's: patches | single P | single P and 25 microseconds |")
    print("|---|---|---|---|")
    own, other = (np.nanstd(DISTANCE / times, axis=0, ddof=1) / np.nanmean(DISTANCE / times, axis=0) for times in both)
    speed = np.nanmean(DISTANCE / single, axis=0)
    relative = own, other, np.hypot(other, ERROR * speed / DISTANCE)
    for content, target, *values in zip(contents, deviations / means, *relative, strict=True):
        print(f"| {content:g} | {' | '.join(f'{value / target:.2f}' for value in values)} |")
    tell_apart(contents, patches, single)
    if given.figure:
        names = ("paper, Table 3", "preset paper, P in patches", "single P", "single P, error of 25 microseconds")
        shown = dict(zip(names, (published, own_time, other_time, with_error), strict=True))
        draw(contents, shown).savefig(given.figure, dpi=150)


def travel_times(database: str, contents: np.ndarray) -> np.ndarray:
    """Travel times over the paper's distance in s, (seed, content), NaN where there is no velocity."""
    with open_campaign(database) as campaign:
        return DISTANCE / campaign.vs().sel(content=contents, method="nearest").transpose("seed", "content").to_numpy()


def tell_apart(contents: np.ndarray, patches: np.ndarray, single: np.ndarray) -> None:
    """Print what differs between both: the uncemented sample, and neighbouring contents of one seed."""
    low = np.flatnonzero(contents < P_ALONE)
    noisy = single + np.random.default_rng(35).normal(0.0, ERROR, single.shape)
    print("\nmean rank correlation of Vs of one seed at neighbouring contents up to 0.66 %:")
    for name, times in (("patches", patches), ("single P", single), ("single P and 25 microseconds", noisy)):
        found = [stats.spearmanr(times[:, a], times[:, b], nan_policy="omit").statistic for a, b in pairwise(low)]
        print(f"  {name}: {np.mean(found):.2f}")
    alone = 200.0**2 * ERROR / DISTANCE
    print(f"sd of Vs of the one uncemented sample, at 200 m/s: 0 with patches, {alone:.0f} m/s with the error")


@apply_style
def draw(contents: np.ndarray, deviations: dict[str, np.ndarray]) -> Figure:
    """Draw standard deviations of the travel time (s) against content."""
    figure = new_figure(height=3.4)
    axes = figure.subplots()
    looks = zip((VERMILION, BLUE, GREY, GREEN), ("D--", "o-", "s-", "^-"), strict=True)
    for (name, values), (colour, look) in zip(deviations.items(), looks, strict=True):
        axes.plot(contents, 1e6 * values, look, color=colour, markersize=4, label=name)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(CONTENT_LABEL)
    axes.set_ylabel("sd of the travel time (microseconds)")
    axes.legend()
    return figure


if __name__ == "__main__":
    main()
