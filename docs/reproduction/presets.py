"""Mean Vs of several campaigns side by side: `python docs/reproduction/presets.py A.db B.db ...`."""

import argparse

import numpy as np

from calcidem.analysis.published import published_study
from calcidem.app.campaign.opened import open_campaign


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("databases", nargs="+")
    printed = {
        content: f"{row.mean:.0f} ± {row.standard_deviation:.0f}" for content, row in published_study().velocities
    }
    columns = []
    for database in parser.parse_args().databases:
        with open_campaign(database) as campaign:
            columns.append((campaign.record.name, campaign.vs()))
    print(f"| content % | paper | {' | '.join(name for name, _ in columns)} |")
    print(f"|{'---|' * (len(columns) + 2)}")
    for content in columns[0][1]["content"].to_numpy().tolist():
        shown = [mean_and_deviation(vs.sel(content=content).to_numpy()) for _, vs in columns]
        print(f"| {content:g} | {printed.get(content, '')} | {' | '.join(shown)} |")


def mean_and_deviation(values: np.ndarray) -> str:
    """Mean and standard deviation, m/s."""
    found = values[np.isfinite(values)]
    return f"{found.mean():.0f} ± {found.std(ddof=1):.0f}" if found.size > 1 else ""


if __name__ == "__main__":
    main()
