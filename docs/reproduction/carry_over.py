"""What the packing does to the scatter of Vs, and how far the law between Vs and C_d,n carries over.

`python docs/reproduction/carry_over.py DB` reads the database that `calcidem sensitivity docs/reproduction/beyond.toml`
made, and prints two tables.
"""

import argparse
from pathlib import Path

import numpy as np
import xarray as xr
from variance import variance_parts

from calcidem.analysis.fits import PowerLawFit, fit_power_law
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.studies.sensitivity import REFERENCE, Variant, read_variants
from calcidem.storage.errors import UnknownCampaignError

PLAN = Path(__file__).with_name("beyond.toml")


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
    """Predict the samples of each variant with its own law and with that of the reference."""
    reference = next(found for variant, found in cells.items() if variant.name == REFERENCE)
    law = fit_law(reference)
    print(f"\nlaw of the reference: Vs = {law.a:.0f} C^{law.b:.2f} {law.c:+.0f}\n")
    print("| sample | own law | rms error of own law, m/s | rms error of the reference's law | its bias |")
    print("|---|---|---|---|---|")
    for variant, found in cells.items():
        connectivity, vs = (found[name].to_numpy().ravel() for name in ("path_normalized_connectivity", "vs"))
        error = vs - law.predict(connectivity)
        error = error[np.isfinite(error)]
        try:
            own = fit_law(found)
            shown = f"{own.a:.0f} C^{own.b:.2f} {own.c:+.0f} | {own.residual_standard_deviation:.0f}"
        except ValueError:  # samples that a straight line in log C fits as well: a and c grow without end
            shown = "does not converge |"
        row = f"{variant.name} | {shown} | {float(np.sqrt(np.mean(error**2))):.0f}"
        print(f"| {row} | {np.mean(error):+.0f} |")


def fit_law(found: xr.Dataset) -> PowerLawFit:
    """Law of a campaign."""
    return fit_power_law(found["path_normalized_connectivity"].to_numpy().ravel(), found["vs"].to_numpy().ravel())


if __name__ == "__main__":
    main()
