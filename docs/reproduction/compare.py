"""Means, scatter and growth of a campaign beside the paper's: `python docs/reproduction/compare.py CAMPAIGN.db`.

`shapes.py` prints the shape of the distributions, `laws.py` what connectivity says, `features.py` what predicts Vs.
"""

import argparse
from collections.abc import Callable

import numpy as np
from published_check import growth_by_stage
from scipy.interpolate import PchipInterpolator, make_interp_spline

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.distribution import Distribution
from calcidem.analysis.measured import PublishedVelocity, published_study
from calcidem.app.campaign.opened import open_campaign

CALIBRATED = (0.11, 0.66, 2.55, 5.0, 9.0)


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    with open_campaign(parser.parse_args().database) as campaign:
        analysis = campaign.analyse()
        here = {round(row.content, 6): row.vs for row in analysis.distributions}
        printed = [row for row in published_study().velocities if round(row[0], 6) in here]
        rows = [(content, here[round(content, 6)], row) for content, row in printed]
        print_means(rows, campaign.vs().sizes["seed"])
        print_baseline(rows)
        print_rates(analysis)


Row = tuple[float, Distribution, PublishedVelocity]


def print_means(rows: list[Row], seeds: int) -> None:
    """Print means and standard deviations, and scatter (sd / mean) over the published one; calibrated in italics."""
    print(
        f"\n| % | read of {seeds} | mean, m/s (95 %) | published | difference "
        "| sd, m/s (95 %) | published | scatter (95 %) |\n|---|---|---|---|---|---|---|---|"
    )
    for content, vs, printed in rows:
        mean, deviation = vs.mean_interval, vs.standard_deviation_interval
        target = vs.mean * printed.standard_deviation / printed.mean
        print(
            f"| {f'*{content:g}*' if content in CALIBRATED else f'{content:g}'} | {vs.n} "
            f"| {vs.mean:.0f} ({mean.low:.0f} to {mean.high:.0f}) | {printed.mean:.0f} "
            f"| {100 * (vs.mean / printed.mean - 1):+.1f} % "
            f"| {vs.standard_deviation:.0f} ({deviation.low:.0f} to {deviation.high:.0f}) "
            f"| {printed.standard_deviation:.0f} "
            f"| {vs.standard_deviation / target:.2f} ({deviation.low / target:.2f} to {deviation.high / target:.2f}) |"
        )
    for title, chosen in (
        ("all", rows),
        ("calibrated", [row for row in rows if row[0] in CALIBRATED]),
        ("predicted", [row for row in rows if row[0] not in CALIBRATED]),
    ):
        differences = np.array([vs.mean / printed.mean - 1 for _, vs, printed in chosen])
        print(
            f"\n{title}: largest difference {100 * np.abs(differences).max():.1f} %, "
            f"rms {100 * np.sqrt(np.mean(differences**2)):.1f} %"
        )


BASELINES: dict[str, Callable[[np.ndarray, np.ndarray], Callable[[np.ndarray], np.ndarray]]] = {
    "linear": lambda x, y: make_interp_spline(x, y, k=1),
    "monotone cubic (PCHIP)": PchipInterpolator,
    "quadratic": lambda x, y: make_interp_spline(x, y, k=2),
    "cubic": lambda x, y: make_interp_spline(x, y, k=3),
}


def interpolated(
    contents: np.ndarray, values: np.ndarray, known: np.ndarray, curve: str, *, logarithmic: tuple[bool, bool]
) -> np.ndarray:
    """Interpolate published values at some contents to all, without any simulation.

    Parameters
    ----------
    contents, values
        Percent and m/s, shape (n,).
    known
        Which of them may be used, shape (n,).
    curve
        One of `BASELINES`.
    logarithmic
        Whether contents and values are interpolated as logarithms.
    """
    x, y = (np.log(one) if log else one for one, log in zip((contents, values), logarithmic, strict=True))
    found = BASELINES[curve](x[known], y[known])(x)
    return np.asarray(np.exp(found) if logarithmic[1] else found)


def print_baseline(rows: list[Row]) -> None:
    """Print how near the eleven other contents come by interpolation between the five calibrated ones."""
    contents = np.array([content for content, _, _ in rows])
    known = np.isin(contents, CALIBRATED)
    if known.sum() < len(CALIBRATED) or known.all():
        return
    means = np.array([printed.mean for _, _, printed in rows])
    deviations = np.array([printed.standard_deviation for _, _, printed in rows])
    print("\n| eleven other contents | means, rms difference | sd, rms difference of the natural logarithm |")
    print("|---|---|---|")

    def show(name: str, mean: np.ndarray, deviation: np.ndarray) -> None:
        off = np.sqrt(np.mean((mean / means - 1)[~known] ** 2))
        apart = np.sqrt(np.mean(np.log(np.where(deviation > 0, deviation, np.nan) / deviations)[~known] ** 2))
        print(f"| {name} | {100 * off:.1f} % | {apart:.3f} |")

    measured = [(vs.mean, vs.standard_deviation) for _, vs, _ in rows]
    show("the campaign", *np.array(measured).T)
    for curve in BASELINES:
        for scales in ((False, False), (False, True), (True, False), (True, True)):
            words = [("", "log ")[log] + axis for log, axis in zip(scales, ("content", "Vs"), strict=True)]
            mean, deviation = (
                interpolated(contents, values, known, curve, logarithmic=scales) for values in (means, deviations)
            )
            show(f"{curve}, {words[1]} against {words[0]}", mean, deviation)


def print_rates(analysis: CampaignAnalysis) -> None:
    """Print the growth of the four stages."""
    print("\n| stage | rate, m/s per % | published |", "|---|---|---|", sep="\n")
    rows = analysis.distributions
    found = growth_by_stage([row.content for row in rows], [row.vs.mean for row in rows])
    for growth, printed in zip(found, published_study().stages, strict=True):
        print(f"| {printed['name']} | {growth.end_point_slope:.0f} | {printed['rate']:.0f} |")


if __name__ == "__main__":
    main()
