"""Two campaigns in one figure: mean and scatter of Vs, and the differences of the same seeds.

    python examples/compare_campaigns.py ONE.db OTHER.db FIGURE.png

Intervals cover the seeds of one packing; without cement all seeds are one sample, and left out. The same seed places
cement alike if packing, pattern and root_seed are the same. Then the paired difference has a narrower 95 % interval
than that of the means of all samples (Welch). It is empty for other packings.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy import stats

import calcidem


def differing(one: calcidem.Campaign, other: calcidem.Campaign) -> dict[str, tuple[object, object]]:
    """Values of the keys in which the physical configurations differ."""
    first, second = (pd.json_normalize(campaign.config).iloc[0].to_dict() for campaign in (one, other))
    both = {key: (first.get(key), second.get(key)) for key in sorted(first.keys() | second.keys())}
    return {key: values for key, values in both.items() if str(values[0]) != str(values[1])}


def half_width(*samples: np.ndarray) -> float:
    """Half the 95 % interval of the mean of a sample, or of the difference of two means (Welch 1947)."""
    parts = np.array([values.var(ddof=1) / values.size for values in samples])
    squares = sum(part**2 / (one.size - 1) for part, one in zip(parts, samples, strict=True)) or 1.0  # of no scatter
    return float(stats.t.ppf(0.975, max(1.0, parts.sum() ** 2 / squares)) * np.sqrt(parts.sum()))


def compare(one: calcidem.Campaign, other: calcidem.Campaign) -> pd.DataFrame:
    """Means, deviations, differences (other minus one) and their half-widths, m/s, by content."""
    first, second = one.vs(), other.vs()
    rows, is_paired = {}, one.packing().content_hash == other.packing().content_hash
    for content in np.setdiff1d(np.intersect1d(first.content, second.content), [0.0]):
        a, b = (vs.sel(content=content).dropna("seed") for vs in (first, second))
        pairs, a, b = ((b - a).to_numpy(), a.to_numpy(), b.to_numpy())  # xarray pairs the seeds that both have
        if min(pairs.size, a.size, b.size) < 2:  # no scatter is known
            continue
        row = {"n": a.size, "mean": a.mean(), "sd": a.std(ddof=1)}
        row |= {"other n": b.size, "other mean": b.mean(), "other sd": b.std(ddof=1)}
        row |= {"difference": b.mean() - a.mean(), "+-": half_width(a, b)}
        pairs = pairs if is_paired else np.full(2, np.nan)
        rows[content] = row | {"pairs": pairs.size * is_paired, "paired": pairs.mean(), "paired +-": half_width(pairs)}
    return pd.DataFrame(rows).T.rename_axis("content, %")


def draw(table: pd.DataFrame, names: tuple[str, str]) -> plt.Figure:
    """Means with standard deviations above, paired differences with their intervals below."""
    figure, (upper, lower) = plt.subplots(2, 1, sharex=True, layout="constrained")
    aside = 0.006 * np.ptp(table.index)
    for name, which, shift in zip(names, ("", "other "), (-aside, aside), strict=True):
        upper.errorbar(table.index + shift, table[f"{which}mean"], table[f"{which}sd"], fmt="o", capsize=3, label=name)
    lower.errorbar(table.index, table["paired"], table["paired +-"], fmt="o", capsize=3)
    lower.axhline(0.0, color="grey", linewidth=0.8)
    upper.set_ylabel("$V_s$ (m/s), mean and sd")
    lower.set(xlabel="calcite content (%)", ylabel="paired difference (m/s)")
    upper.legend()
    return figure


def main() -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("one", "other", "figure"):
        parser.add_argument(name)
    options = parser.parse_args()
    with calcidem.open_campaign(options.one) as one, calcidem.open_campaign(options.other) as other:
        table = compare(one, other)
        if table.empty:
            raise SystemExit("There is no content with cement at which both campaigns have two velocities.")
        print(table.round(1).to_string(), *map(str, differing(one, other).items()), sep="\n")
        draw(table, (options.one, options.other)).savefig(options.figure)


if __name__ == "__main__":
    main()
