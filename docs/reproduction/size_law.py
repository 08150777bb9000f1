"""Scatter of Vs against the size of the sample: a law of three sizes, and a fourth that it is tested on.

`python docs/reproduction/size_law.py DB` reads what `calcidem sensitivity docs/reproduction/size.toml` computed.
The scatter is the standard deviation over the mean, and has that of the reading in it.
"""

import argparse
from pathlib import Path

import numpy as np
import xarray as xr

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.studies.variants import read_variants
from calcidem.storage.errors import UnknownCampaignError

PLAN = Path(__file__).with_name("size.toml")
REPLICATES = 2000


def scatter(vs: np.ndarray) -> np.ndarray:
    """Standard deviation over mean; values in the last axis, NaN left out."""
    return np.asarray(np.nanstd(vs, axis=-1, ddof=1) / np.nanmean(vs, axis=-1))


def main() -> None:
    """Print the scatter at each size, and for each content the law, its exponent and what it says of the largest."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    database, found = parser.parse_args().database, dict[float, xr.Dataset]()
    for variant in read_variants(PLAN, database):
        try:
            with open_campaign(database, variant.name) as campaign:
                found[variant.configuration.packing.width] = campaign.to_xarray(["vs"])
        except UnknownCampaignError:
            print(f"not computed: {variant.name}")
    widths = sorted(found)
    *fitted, tested = widths
    print(f"fitted: {', '.join(f'{width:g} m' for width in fitted)}; tested: {tested:g} m\n")
    sizes = " | ".join(f"{width:g} m" for width in widths)
    print(f"| content % | {sizes} | exponent (95 %) | law at {tested:g} m (95 %) |")
    print("|---|" + "---|" * (len(widths) + 2))
    draws = np.random.default_rng(1)
    for content in found[widths[0]]["content"].to_numpy():
        columns = []
        for width in widths:
            cells = found[width].sel(content=content)
            vs = cells["vs"].to_numpy()
            chosen = np.concatenate([np.arange(len(vs))[None], draws.integers(len(vs), size=(REPLICATES, len(vs)))])
            columns.append(scatter(vs[chosen]))
        values = np.array(columns)  # (sizes, 1 + replicates)
        slope, level = np.polyfit(np.log(fitted), np.log(values[:-1]), 1)
        law = np.exp(level + slope * np.log(tested))
        shown = [f"{100 * value:.1f} %" for value in values[:, 0]]
        low, high = np.percentile(slope[1:], [2.5, 97.5])
        # What is tested has an error of its own.
        ratio = np.percentile(law[1:] * values[-1, 0] / values[-1, 1:], [2.5, 97.5])
        print(
            f"| {content:g} | {' | '.join(shown)} | {slope[0]:.2f} ({low:.2f} to {high:.2f}) "
            f"| {100 * law[0]:.1f} % ({100 * ratio[0]:.1f} to {100 * ratio[1]:.1f} %) |"
        )


if __name__ == "__main__":
    main()
