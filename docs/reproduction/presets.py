"""Mean Vs of several campaigns side by side: `python docs/reproduction/presets.py A.db B.db ...`."""

import argparse

import numpy as np

from calcidem.analysis.published import published_study
from calcidem.app.campaign.opened import open_campaign


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("databases", nargs="+")
    rows = {
        "published": {
            content: f"{row.mean:.0f} ± {row.standard_deviation:.0f}" for content, row in published_study().velocities
        }
    }
    for database in parser.parse_args().databases:
        with open_campaign(database) as campaign:
            vs = campaign.vs()
            contents = vs["content"].to_numpy().tolist()
            rows[campaign.record.name] = {
                content: mean_and_deviation(vs.sel(content=content).to_numpy()) for content in contents
            }
    print(f"| content % | {' | '.join(f'{content:g}' for content in contents)} |")
    print(f"|{'---|' * (len(contents) + 1)}")
    for name, cells in rows.items():
        print(f"| {name} | {' | '.join(cells.get(content, '') for content in contents)} |")


def mean_and_deviation(values: np.ndarray) -> str:
    """Mean and standard deviation, m/s."""
    found = values[np.isfinite(values)]
    return f"{found.mean():.0f} ± {found.std(ddof=1):.0f}" if found.size > 1 else ""


if __name__ == "__main__":
    main()
