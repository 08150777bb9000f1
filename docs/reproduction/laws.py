"""What connectivity says of Vs (Table 4, Figs. 13 and 14): `python docs/reproduction/laws.py CAMPAIGN.db`."""

import argparse
from collections.abc import Callable

import numpy as np
import xarray as xr
from scipy import stats

from calcidem.analysis.campaign_analysis import CampaignAnalysis, LawFit
from calcidem.analysis.correlation import correlate, seed_permutation_test
from calcidem.analysis.measured import published_study
from calcidem.analysis.packing_graph import FEATURES
from calcidem.app.campaign.opened import open_campaign

C_DN = "path_normalized_connectivity"
SIGNIFICANCE = 0.05


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    with open_campaign(parser.parse_args().database) as campaign:
        analysis = campaign.analyse()
        print_features(analysis)
        print_contents(analysis)
        print_laws(analysis)


def correlate_by_content(table: xr.Dataset) -> xr.Dataset:
    """Correlate the features of a table with Vs at each content of at least ten samples; NaN for constant features.

    Intervals of Spearman's coefficient with the variance of Bonett and Wright (2000, doi:10.1007/BF02294183) hold at
    all contents together (Bonferroni); p for all features and contents is corrected (Benjamini and Hochberg 1995).
    """
    names = [name for name in table.data_vars if name != "vs"]
    shape = (len(names), table.sizes["content"])
    found = {name: np.full(shape, np.nan) for name in ("pearson", "pearson_log", "spearman", "p", "n")}
    for column, content in enumerate(table["content"].to_numpy()):
        samples = table.sel(content=content).dropna("seed")
        vs = samples["vs"].to_numpy()
        for row, values in enumerate(samples[name].to_numpy() for name in names):
            if len(vs) >= 10 and np.ptp(values) > 1e-12 * np.abs(values).max():
                rank = stats.spearmanr(values, vs)
                linear, logarithmic = (stats.pearsonr(values, y).statistic for y in (vs, np.log(vs)))
                here = linear, logarithmic, rank.statistic, rank.pvalue, len(vs)
                for name, number in zip(found, here, strict=True):
                    found[name][row, column] = number
    p, spearman, known = found["p"], found["spearman"], np.isfinite(found["p"])
    found["p_corrected"] = np.full(shape, np.nan)
    found["p_corrected"][known] = stats.false_discovery_control(p[known])
    normal = stats.norm.ppf(1 - 0.05 / (2 * known.any(axis=0).sum()))
    half = normal * np.sqrt((1 + spearman**2 / 2) / (found["n"] - 3))
    found["low"], found["high"] = np.tanh(np.arctanh(spearman) - half), np.tanh(np.arctanh(spearman) + half)
    both = ("variable", "content")
    return xr.Dataset(
        {name: (both, numbers) for name, numbers in found.items()},
        coords={"variable": names, "content": table["content"]},
    )


def print_features(analysis: CampaignAnalysis) -> None:
    """Print coefficients over all contents and within one."""
    matrices, tests = correlate(analysis.table), seed_permutation_test(analysis.table, "vs")
    by_content = correlate_by_content(analysis.table)
    logarithm = analysis.table.assign(log_vs=np.log(analysis.table["vs"]))
    of_all = "Pearson", "with log Vs", "Spearman"
    show_header("feature", *of_all, "within: Spearman", "p, corrected", "contents")
    for name, (symbol, _) in FEATURES.items():
        overall, within = (part.sel(variable=name, other="vs") for part in (matrices.overall, matrices.within))
        values = logarithm[[name, "log_vs"]].to_array("name").stack(sample=("seed", "content")).dropna("sample")
        found = by_content.sel(variable=name)["p_corrected"]
        print(
            f"| {symbol} | {float(overall['pearson']):+.2f} | {np.corrcoef(values)[0, 1]:+.2f} "
            f"| {float(overall['spearman']):+.2f} | {float(within['spearman']):+.2f} "
            f"| {float(tests['p_corrected'].sel(variable=name)):.2g} "
            f"| {int((found < SIGNIFICANCE).sum())} of {int(found.notnull().sum())} |"
        )
    scan = analysis.ratio_scan
    interval = scan.best_ratio_interval
    at_paper = float(np.interp(0.83, scan.ratios, scan.correlation))
    print(
        f"\nbest ratio {scan.best_ratio:.2f} ({interval.low:.2f} to {interval.high:.2f}), "
        f"correlation {scan.best_correlation:.3f}; at the paper's 0.83 {at_paper:.3f}"
    )


def print_contents(analysis: CampaignAnalysis) -> None:
    """Print how C_d,n goes with Vs at each content."""
    found = correlate_by_content(analysis.table).sel(variable=C_DN)
    show_header("%", "Pearson", "with log Vs", "Spearman (95 % for all contents)", "p", "p, corrected")
    for content in found["content"].to_numpy()[np.isfinite(found["spearman"].to_numpy())]:
        row = found.sel(content=content)
        print(
            f"| {content:g} | {float(row['pearson']):+.2f} | {float(row['pearson_log']):+.2f} "
            f"| {float(row['spearman']):+.2f} ({float(row['low']):+.2f} to {float(row['high']):+.2f}) "
            f"| {float(row['p']):.2g} | {float(row['p_corrected']):.2g} |"
        )


def print_laws(analysis: CampaignAnalysis) -> None:
    """Print laws of Table 4 and the content alone, with their errors on unseen seeds."""
    ratio = next(law.weights.ratio for law in published_study().laws if law.name == "Monte-Carlo")
    laws = (
        analysis.physical_law,
        analysis.law_of_ratio(ratio, f"ratio of the paper, {ratio:g}"),
        analysis.law_of_ratio(analysis.ratio_scan.best_ratio, "best ratio"),
    )
    known = np.isfinite(analysis.sample_vs)
    vs, seeds = analysis.sample_vs[known], analysis.sample_seeds[known]
    contents = np.array([sample.content for sample in analysis.samples])[known]
    cemented = contents > 0  # without cement there is no other sample
    alone = np.where(cemented, vs - without_seed(seeds, lambda rows: mean_of_content(contents, vs, rows)), np.nan)
    errors = {"content alone": alone}
    show_header("weights by", "weights", "range of C_d,n", "law", "Pearson", "rms error on unseen seeds, m/s")
    for law in laws:
        errors[law.name] = law.check.errors
        show_law(law, vs, known)
    for printed in published_study().laws:
        low, high = printed.connectivity_range.low, printed.connectivity_range.high
        print(
            f"| {printed.name}, paper | {printed.weights.hertz:g}, {printed.weights.bond:g} | {low:g} to {high:g} "
            f"| {printed.a:.0f} C^{printed.conclusions_b:g} {printed.c:+.0f} | | |"
        )
    print(f"| content alone | | | mean of the content | | {rms(errors['content alone']):.0f} |")
    show_header("bias by content, m/s", *errors)
    for content in np.unique(contents):
        values = [f"{found[contents == content].mean():+.0f}" for found in errors.values()]
        print(f"| {content:g} | {' | '.join(values)} |")


def show_law(law: LawFit, vs: np.ndarray, known: np.ndarray) -> None:
    """Print a law of ours."""
    coefficient = np.corrcoef(law.connectivity[known], vs)[0, 1]
    print(
        f"| {law.name} | {law.weights.hertz:.3f}, {law.weights.bond:.3f} "
        f"| {law.connectivity.min():.3f} to {law.connectivity.max():.3f} "
        f"| {law.fit.a:.0f} C^{law.fit.b:.2f} {law.fit.c:+.0f} | {coefficient:.3f} | {rms(law.check.errors):.0f} |"
    )


def without_seed(seeds: np.ndarray, predict: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Predict the samples of each seed from those of the others; `predict` takes the rows it may use."""
    predicted = np.empty(seeds.size)
    for seed in np.unique(seeds):
        predicted[seeds == seed] = predict(seeds != seed)[seeds == seed]
    return predicted


def mean_of_content(contents: np.ndarray, vs: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Mean over the rows at the content of each sample, m/s."""
    _, place = np.unique(contents, return_inverse=True)
    sums, counts = (np.bincount(place, weights=rows * weight) for weight in (vs, np.ones_like(vs)))
    return np.asarray((sums / np.where(counts > 0, counts, np.nan))[place])


def rms(errors: np.ndarray) -> float:
    """Root mean square of the known values."""
    return float(np.sqrt(np.nanmean(errors**2)))


def show_row(*cells: object) -> None:
    """Print a row of a table."""
    print(f"| {' | '.join(str(cell) for cell in cells)} |")


def show_header(*cells: object) -> None:
    """Print the first row of a table and the line below it."""
    print()
    show_row(*cells)
    print(f"|{'---|' * len(cells)}")


if __name__ == "__main__":
    main()
