"""The tables that hold a campaign beside the paper: `python docs/reproduction/compare.py CAMPAIGN.db`."""

import argparse

import numpy as np
import xarray as xr

from calcidem.analysis.campaign_analysis import CampaignAnalysis, LawFit
from calcidem.analysis.distribution import Distribution
from calcidem.analysis.features import FEATURES
from calcidem.analysis.published import PublishedVelocity, published_study
from calcidem.analysis.published_check import check_verdicts
from calcidem.app.campaign.opened import open_campaign

CALIBRATED = (0.11, 0.66, 2.55, 5.0, 9.0)
SIGNIFICANCE = 0.05
DISAGREE = 0.05  # of the peak's velocity; so does a correlation that was refused
NORMAL_QUARTILES = 1.349  # standard deviations of a normal distribution between its quartiles


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    with open_campaign(parser.parse_args().database) as campaign:
        analysis = campaign.analyse()
        here = {round(row.content, 6): row.vs for row in analysis.distributions}
        printed = [row for row in published_study().velocities if round(row[0], 6) in here]
        rows = [(content, here[round(content, 6)], row) for content, row in printed]
        print_means(rows)
        print_scatter(rows, campaign.to_xarray(("vs", "vs_cross_correlation")))
        print_shapes(rows)
        print_rates(analysis)
        print_laws(analysis)
        print_features(analysis)


Row = tuple[float, Distribution, PublishedVelocity]


def print_means(rows: list[Row]) -> None:
    """Print means and standard deviations, calibrated contents apart."""
    for title, chosen in (
        ("calibrated", [row for row in rows if row[0] in CALIBRATED]),
        ("predicted", [row for row in rows if row[0] not in CALIBRATED]),
    ):
        print(f"\n| {title}, % | mean, m/s (95 %) | published | difference | sd, m/s (95 %) | published | ratio |")
        print("|---|---|---|---|---|---|---|")
        for content, vs, printed in chosen:
            mean, scatter = vs.mean_interval, vs.standard_deviation_interval
            print(
                f"| {content:g} | {vs.mean:.0f} ({mean.low:.0f} to {mean.high:.0f}) | {printed.mean:.0f} "
                f"| {100 * (vs.mean / printed.mean - 1):+.1f} % "
                f"| {vs.standard_deviation:.0f} ({scatter.low:.0f} to {scatter.high:.0f}) "
                f"| {printed.standard_deviation:.0f} | {vs.standard_deviation / printed.standard_deviation:.2f} |"
            )
        differences = np.array([vs.mean / printed.mean - 1 for _, vs, printed in chosen])
        print(
            f"\n{title}: largest difference {100 * np.abs(differences).max():.1f} %, "
            f"rms {100 * np.sqrt(np.mean(differences**2)):.1f} %"
        )


def print_scatter(rows: list[Row], cells: xr.Dataset) -> None:
    """Print sd / mean, the same from quartiles, the share that was read, and where two readings disagree."""
    print(
        "\n| % | read | sd / mean | published | over published (95 %) | by quartiles | readings disagree |",
        "|---|---|---|---|---|---|---|",
        sep="\n",
    )
    for content, here, printed in rows:
        peaks, others = (cells[name].sel(content=content).to_numpy() for name in ("vs", "vs_cross_correlation"))
        found = np.isfinite(peaks)
        lower, median, upper = np.percentile(peaks[found], [25, 50, 75])
        target = printed.standard_deviation / printed.mean
        scatter, interval = here.standard_deviation / here.mean, here.standard_deviation_interval
        apart = ~(np.abs(others[found] / peaks[found] - 1.0) <= DISAGREE)
        print(
            f"| {content:g} | {found.sum()} of {found.size} | {scatter:.3f} | {target:.3f} | {scatter / target:.2f} "
            f"({interval.low / here.mean / target:.2f} to {interval.high / here.mean / target:.2f}) "
            f"| {(upper - lower) / NORMAL_QUARTILES / median / target:.2f} | {100 * apart.mean():.0f} % |"
        )


def print_shapes(rows: list[Row]) -> None:
    """Print skewness, kurtosis and the verdicts of Jarque and Bera."""
    by_moments = {check.content: check for check in check_verdicts()}
    print("\n| % | skewness | published | kurtosis | published | p here | normal here | printed | by printed moments |")
    print("|---|---|---|---|---|---|---|---|---|")
    agree = 0
    for content, vs, printed in rows:
        p_value = vs.normality.p_asymptotic
        normal = p_value >= SIGNIFICANCE
        agree += normal == printed.normal
        verdict = by_moments[content].computed_normal
        print(
            f"| {content:g} | {vs.skewness:.2f} | {printed.skewness:.2f} | {vs.kurtosis:.2f} | {printed.kurtosis:.2f} "
            f"| {p_value:.2g} | {word(normal)} | {word(printed.normal)} | {word(verdict)} |"
        )
    print(f"\nverdicts that agree with the printed ones: {agree} of {len(rows)}")


def print_rates(analysis: CampaignAnalysis) -> None:
    """Print the growth of the four stages."""
    print("\n| stage | rate, m/s per % | published |", "|---|---|---|", sep="\n")
    for growth, printed in zip(analysis.stages, published_study().stages, strict=True):
        print(f"| {printed.name} | {growth.end_point_slope:.0f} | {printed.rate:.0f} |")


def print_laws(analysis: CampaignAnalysis) -> None:
    """Print the two laws of Table 4."""
    print(
        "\n| | weights | range of C_d,n | law | correlation | rms error on unseen seeds, m/s |",
        "|---|---|---|---|---|---|",
        sep="\n",
    )
    for law, printed in zip((analysis.physical_law, analysis.scanned_law), published_study().laws, strict=True):
        print_law(law, analysis)
        low, high = printed.connectivity_range.low, printed.connectivity_range.high
        print(
            f"| {printed.name}, paper | {printed.weights.hertz:g}, {printed.weights.bond:g} | {low:g} to {high:g} "
            f"| {printed.a:.0f} C^{printed.conclusions_b:g} {printed.c:+.0f} | | |"
        )


def print_law(law: LawFit, analysis: CampaignAnalysis) -> None:
    """Print our own law."""
    found = np.isfinite(analysis.sample_vs)
    coefficient = np.corrcoef(law.connectivity[found], analysis.sample_vs[found])[0, 1]
    low, high = law.connectivity.min(), law.connectivity.max()
    print(
        f"| {law.name} | {law.weights.hertz:.3f}, {law.weights.bond:.3f} | {low:.3f} to {high:.3f} "
        f"| {law.fit.a:.0f} C^{law.fit.b:.2f} {law.fit.c:+.0f} | {coefficient:.3f} "
        f"| {law.check.root_mean_square_error:.0f} |"
    )


def print_features(analysis: CampaignAnalysis) -> None:
    """Print the correlations of Fig. 13, and the best ratio of Fig. 14."""
    matrices = analysis.correlations
    print("\n| feature | over all contents | within a content |", "|---|---|---|", sep="\n")
    for feature in FEATURES:
        values = [
            float(matrix["pearson"].sel(variable=feature.name, other="vs"))
            for matrix in (matrices.overall, matrices.within)
        ]
        print(f"| {feature.symbol} | {values[0]:+.2f} | {values[1]:+.2f} |")
    scan = analysis.ratio_scan
    interval = scan.best_ratio_interval
    print(
        f"\nbest ratio {scan.best_ratio:.2f} ({interval.low:.2f} to {interval.high:.2f}), "
        f"correlation {scan.best_correlation:.3f}; paper 0.83"
    )


def word(normal: bool) -> str:
    """Verdict in a word."""
    return "yes" if normal else "no"


if __name__ == "__main__":
    main()
