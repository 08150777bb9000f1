"""Draw scatter.png: scatter and skewness of Vs in the paper, in the campaign, and with two choices changed.

`python docs/reproduction/draw_scatter.py SCATTER.db CAMPAIGN.db` takes what `calcidem sensitivity
docs/reproduction/scatter.toml` computed, and a campaign of the preset `paper-small-pulse`.
"""

import argparse
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import (
    BLACK,
    BLUE,
    CONTENT_LABEL,
    FIGURE_WIDTH,
    GREEN,
    SKY,
    VERMILION,
    apply_style,
    render,
)
from calcidem.analysis.normality import skewness
from calcidem.analysis.published import published_study
from calcidem.app.campaign.opened import open_campaign

HERE = Path(__file__).parent
BANDS = "receiver of 10 mm half-width"
CURVES = {
    f"{BANDS}: alone": ("receiver of 10 mm", SKY),
    f"{BANDS}: with clusters of 18 mm": ("receiver of 10 mm, clusters of 18 mm", VERMILION),
    f"{BANDS}: with C alone above the threshold": ("receiver of 10 mm, P not kept", GREEN),
}


@apply_style
def draw(database: str, whole: str) -> Figure:
    """Draw both panels."""
    figure = Figure(figsize=(FIGURE_WIDTH * 1.25, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    rows = published_study().velocities
    contents = [content for content, _ in rows]
    left.plot(contents, [row.standard_deviation / row.mean for _, row in rows], "o-", color=BLACK, ms=4, label="paper")
    right.plot(contents, [row.skewness for _, row in rows], "o-", color=BLACK, ms=4)
    with open_campaign(whole) as stored:
        campaign = stored.vs().sel(content=slice(0.1, None))
    scatter, asymmetry = shape(campaign)
    left.plot(campaign["content"], scatter, color=BLUE, label="campaign, 116 seeds")
    right.plot(campaign["content"], asymmetry, color=BLUE)
    for name, (label, colour) in CURVES.items():
        with open_campaign(database, name) as variant:
            vs = variant.vs()
        scatter, asymmetry = shape(vs)
        left.plot(vs["content"], scatter, "s--", color=colour, ms=4, lw=1.0, label=f"{label}, {vs.sizes['seed']} seeds")
        right.plot(vs["content"], asymmetry, "s--", color=colour, ms=4, lw=1.0)
    left.set(xlabel=CONTENT_LABEL, ylabel="standard deviation / mean", ylim=(0, 0.3), title="scatter")
    right.set(xlabel=CONTENT_LABEL, ylabel="skewness", title="skewness")
    right.axhline(0.0, color=BLACK, lw=0.6)
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def shape(vs: xr.DataArray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviation over mean, and skewness, along content."""
    columns = [column[np.isfinite(column)] for column in vs.transpose("content", "seed").to_numpy()]
    return (vs.std("seed", ddof=1) / vs.mean("seed")).to_numpy(), np.array([skewness(column) for column in columns])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("database")
    parser.add_argument("campaign")
    options = parser.parse_args()
    (HERE / "scatter.png").write_bytes(render(draw(options.database, options.campaign), "png"))
