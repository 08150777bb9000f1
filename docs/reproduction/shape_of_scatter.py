"""Scatter of variants, its shape, and how much of it the preferential path tells.

`python docs/reproduction/shape_of_scatter.py PLAN.toml DB` reads what
`calcidem sensitivity PLAN.toml --db DB` computed.
"""

import argparse

import numpy as np

from calcidem.analysis.normality import kurtosis, skewness
from calcidem.analysis.published import published_study
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.studies.sensitivity.plan import load_plan
from calcidem.storage.errors import UnknownCampaignError


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plan")
    parser.add_argument("database")
    options = parser.parse_args()
    published = dict(published_study().velocities)
    print("| variant | content % | n | sd / mean | paper | skewness | paper | kurtosis | paper | r of C_d,n and Vs |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for variant in load_plan(options.plan, options.database):
        try:
            with open_campaign(options.database, variant.name) as campaign:
                cells = campaign.to_xarray()
        except UnknownCampaignError:
            continue
        for content in cells["content"].to_numpy().tolist():
            vs, path = (cells[name].sel(content=content).to_numpy() for name in ("vs", "path_normalized_connectivity"))
            found = np.isfinite(vs) & np.isfinite(path)
            vs, path = vs[found], path[found]
            if vs.size < 3 or not vs.std() > 0:  # noqa: PLR2004 - a skewness needs three
                continue
            printed = published[content]
            moments = (
                (vs.std(ddof=1) / vs.mean(), printed.standard_deviation / printed.mean),
                (skewness(vs), printed.skewness),
                (kurtosis(vs), printed.kurtosis),
            )
            shown = " | ".join(f"{here:.3f} | {there:.3f}" for here, there in moments)
            correlation = np.corrcoef(path, vs)[0, 1] if path.std() > 0 else np.nan
            print(f"| {variant.name} | {content:g} | {vs.size} | {shown} | {correlation:+.2f} |")


if __name__ == "__main__":
    main()
