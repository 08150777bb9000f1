"""What the packing does to the scatter of Vs, and how far the laws with G and with C_d,n carry over.

`python docs/reproduction/carry_over.py DB` reads the database that `calcidem sensitivity docs/reproduction/beyond.toml`
made, and prints two tables.
"""

import argparse
from pathlib import Path

import numpy as np
import xarray as xr
from scipy import stats
from variance import variance_parts

from calcidem.analysis.fits import fit_power_law
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.studies.sensitivity import REFERENCE, Variant, read_variants
from calcidem.storage.errors import UnknownCampaignError

PLAN = Path(__file__).with_name("beyond.toml")
FEATURES = {"network_conductance": "G", "path_normalized_connectivity": "C_d,n"}


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    database = parser.parse_args().database
    cells = {}
    for variant in read_variants(PLAN, database):
        try:
            with open_campaign(database, variant.name) as campaign:
                cells[variant] = campaign.to_xarray()
        except UnknownCampaignError:
            print(f"not computed: {variant.name}")
    packings = [found for variant, found in cells.items() if variant.choice in {REFERENCE, "packing"}]
    print_parts(packings)
    print_carry_over(cells)


def print_parts(packings: list[xr.Dataset]) -> None:
    """Divide the variance between packing, cement and both together."""
    print(f"{len(packings)} packings x {packings[0].sizes['seed']} seeds\n")
    print("| content % | mean, m/s | sd, m/s | packing | cement, the same in all packings | both together |")
    print("|---|---|---|---|---|---|")
    for content in packings[0]["content"].to_numpy():
        table = np.stack([found["vs"].sel(content=content).to_numpy() for found in packings])
        table = table[:, np.isfinite(table).all(axis=0)]
        parts = variance_parts(table)
        by_packing, by_seed, rest = parts.deviations
        row = f"{content:g} | {parts.mean:.0f} | {parts.total**0.5:.0f} | {by_packing:.0f} | {by_seed:.0f} | {rest:.0f}"
        print(f"| {row} |")


def print_carry_over(cells: dict[Variant, xr.Dataset]) -> None:
    """Correlate both features with Vs within a content, and predict each variant by the laws of the reference."""
    reference = next(found for variant, found in cells.items() if variant.name == REFERENCE)
    laws = {name: fit_power_law(*columns(reference, name)) for name in FEATURES}
    means = reference["vs"].mean("seed")
    print(
        "\nlaws of the reference: "
        + ", ".join(f"Vs = {law.a:.0f} {FEATURES[name]}^{law.b:.2f} {law.c:+.0f}" for name, law in laws.items())
    )
    print("\n| sample | within a content: G | C_d,n | rms of the law with G, m/s | bias | with C_d,n | content alone |")
    print("|---|---|---|---|---|---|---|")
    for variant, found in cells.items():
        ranks = [
            np.mean(
                [spearman(found[name].sel(content=each), found["vs"].sel(content=each)) for each in found["content"]]
            )
            for name in FEATURES
        ]
        errors = {
            name: vs - laws[name].predict(x) for name, (x, vs) in ((name, columns(found, name)) for name in FEATURES)
        }
        alone = (found["vs"] - means).to_numpy()
        conductance, path = errors.values()
        row = f"{variant.name} | {ranks[0]:+.2f} | {ranks[1]:+.2f} | {rms(conductance):.0f}"
        print(f"| {row} | {np.nanmean(conductance):+.0f} | {rms(path):.0f} | {rms(alone):.0f} |")


def columns(found: xr.Dataset, name: str) -> tuple[np.ndarray, np.ndarray]:
    """A feature and Vs of all samples."""
    return found[name].to_numpy().ravel(), found["vs"].to_numpy().ravel()


def spearman(x: xr.DataArray, vs: xr.DataArray) -> float:
    """Rank correlation of the samples that have both."""
    return float(stats.spearmanr(x, vs, nan_policy="omit").statistic)


def rms(error: np.ndarray) -> float:
    """Root mean square of the finite values."""
    return float(np.sqrt(np.nanmean(error**2)))


if __name__ == "__main__":
    main()
