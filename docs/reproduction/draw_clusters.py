"""Draw clusters.png: scatter and mean of Vs against number and diameter of clusters at equal calcite.

`python docs/reproduction/draw_clusters.py DB` reads what `calcidem sensitivity docs/reproduction/clusters.toml`
computed, and prints how much of the variation of ln(sd / mean) goes with ln(number), with ln(diameter), and with both.
"""

import argparse
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLUE, FIGURE_WIDTH, GREEN, VERMILION, apply_style, render
from calcidem.analysis.intervals import Interval
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.studies.variants import read_variants
from calcidem.storage.errors import UnknownCampaignError

HERE = Path(__file__).parent
REPLICATES = 2000
HALF = 0.5
MM = 1e3

Designs = dict[tuple[float, float], xr.Dataset]


def read_designs(database: str) -> Designs:
    """Cells by diameter (mm) and calcite area of a cluster (mm^2)."""
    found: Designs = {}
    for variant in read_variants(HERE / "clusters.toml", database):
        pattern = variant.configuration.pattern
        try:
            with open_campaign(database, variant.name) as campaign:
                cells = campaign.to_xarray(["vs", "clusters"])
        except UnknownCampaignError:
            print(f"not computed: {variant.name}")
        else:
            found[MM * pattern.cluster_diameter, 1e6 * (pattern.cluster_area or np.nan)] = cells
    return found


def readable(designs: Designs, content: float) -> Designs:
    """Designs of which half of the samples have a velocity at a content."""
    read = {key: float(cells["vs"].sel(content=content).notnull().mean()) for key, cells in designs.items()}
    return {key: cells for key, cells in designs.items() if read[key] >= HALF}


def print_parts(designs: Designs, content: float) -> None:
    """Regress the logarithm of the relative scatter on those of number and diameter; seeds are drawn anew."""
    designs = readable(designs, content)
    cells = [found.sel(content=content) for found in designs.values()]
    numbers = np.log([float(found["clusters"].mean()) for found in cells])
    diameters = np.log([diameter for diameter, _ in designs])
    design = np.column_stack([np.ones(len(cells)), numbers - numbers.mean(), diameters - diameters.mean()])
    vs = np.array([found["vs"].to_numpy() for found in cells])
    draws = np.random.default_rng(1)
    chosen = [np.arange(vs.shape[1]), *draws.integers(vs.shape[1], size=(REPLICATES, vs.shape[1]))]
    scatter = np.array([np.nanstd(vs[:, seeds], axis=1, ddof=1) / np.nanmean(vs[:, seeds], axis=1) for seeds in chosen])
    powers = np.linalg.lstsq(design, np.log(scatter).T, rcond=None)[0][1:]
    # At the same number times square of the diameter about as many contacts are in clusters.
    equal = powers[0] - 0.5 * powers[1]
    for name, row in zip(("number", "diameter", "number at equal area"), (*powers, equal), strict=True):
        low, high = np.percentile(row[1:], [2.5, 97.5])
        print(f"{content:g} %: sd / mean goes with {name}^{row[0]:.2f} ({low:.2f} to {high:.2f})")


@apply_style
def draw(designs: Designs) -> Figure:
    """Draw a line for each diameter, over the number of clusters, for each content."""
    contents = next(iter(designs.values()))["content"].to_numpy()
    figure = Figure(figsize=(FIGURE_WIDTH, 2.6), layout="constrained")
    panels = figure.subplots(1, len(contents), sharey=True)
    diameters = sorted({diameter for diameter, _ in designs})
    for axes, content in zip(panels, contents, strict=True):
        for diameter, colour in zip(diameters, (BLUE, GREEN, VERMILION), strict=False):
            rows = []
            for (own, _), cells in readable(designs, content).items():
                column = cells.sel(content=content)
                vs = column["vs"].to_numpy()
                vs = vs[np.isfinite(vs)]
                if own == diameter:
                    interval = Interval.of_standard_deviation(vs)
                    rows.append(
                        (float(column["clusters"].mean()), vs.std(ddof=1), interval.low, interval.high, vs.mean())
                    )
            number, deviation, low, high, mean = np.array(sorted(rows)).T
            bars = np.array([deviation - low, high - deviation]) / mean
            axes.errorbar(
                number, deviation / mean, bars, fmt="o-", color=colour, ms=4, capsize=2, label=f"{diameter:g} mm"
            )
        axes.set(xscale="log", xlabel="clusters in the sample", title=f"{content:g} %")
        numbers = sorted({round(float(cells["clusters"].sel(content=content).mean())) for cells in designs.values()})
        axes.set_xticks(numbers, map(str, numbers))
        axes.minorticks_off()
    panels[0].set(ylabel="standard deviation / mean", ylim=(0.0, None))
    panels[-1].legend(title="diameter")
    return figure


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("database")
    stored = read_designs(parser.parse_args().database)
    for one in next(iter(stored.values()))["content"].to_numpy():
        print_parts(stored, float(one))
    (HERE / "clusters.png").write_bytes(render(draw(stored), "png"))
