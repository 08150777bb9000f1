"""What the scatter of Vs consists of, at each content: `python docs/reproduction/scatter.py QUIET.db LOUD.db`.

The second campaign has the printed pulse. The table is on docs/reproduction/scatter.md.
"""

import argparse

import numpy as np
import xarray as xr

from calcidem.analysis.measured import PublishedVelocity, published_study
from calcidem.app.campaign.opened import open_campaign

HEADER = (
    *("%", "printed sd / mean", "quiet pulse", "5 m/s", "`effective_vs`", "`static_speed`", "reading error"),
    *("reading, part of variance", "stiffness, part of variance", "pulse of 5 m/s"),
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("quiet")
    parser.add_argument("loud")
    given = parser.parse_args()
    with open_campaign(given.quiet) as one, open_campaign(given.loud) as other:
        quiet, loud = one.to_xarray(), other.to_xarray()
    print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
    for content, printed in published_study().velocities:
        print(f"| {content:g} | {' | '.join(row(quiet.sel(content=content), loud.sel(content=content), printed))} |")


def row(quiet: xr.Dataset, loud: xr.Dataset, printed: PublishedVelocity) -> list[str]:
    """Columns of a content."""
    log = np.log(quiet["vs"].to_numpy())
    known = np.isfinite(log)
    reading = quiet["reading_error"].to_numpy()[known]
    own = float(np.var(log[known], ddof=1))
    stiffness = np.log(quiet["static_speed"].to_numpy())
    both = known & np.isfinite(stiffness)
    r = float(np.corrcoef(log[both], stiffness[both])[0, 1])
    return [
        f"{printed.standard_deviation / printed.mean:.3f}",
        *(f"{relative_deviation(values):.3f}" for values in (quiet["vs"], loud["vs"])),
        *(f"{relative_deviation(quiet[name]):.3f}" for name in ("effective_vs", "static_speed")),
        f"{np.sqrt(np.mean(reading**2)):.3f}",
        f"{np.mean(reading**2) / own:.2f}",
        f"{r * abs(r):.2f}",
        f"{float(loud['pulse_effect'].max()):.3f}",
    ]


def relative_deviation(values: xr.DataArray) -> float:
    """Standard deviation over the mean of the known values."""
    return float(values.std(ddof=1) / values.mean())


if __name__ == "__main__":
    main()
