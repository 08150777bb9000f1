"""Picture of local stiffness: one sample of each content, scatter and scale of fluctuation against content."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import BLUE, MM, VERMILION, apply_style, letter_panels, new_figure

_MOST_MAPS = 6
_GPA = 1e-9


@apply_style
def draw_stiffness(fields: xr.Dataset) -> Figure:
    """Draw the local shear modulus of the first seed at some contents, its scatter, and its scale of fluctuation."""
    contents = fields["content"].to_numpy()
    shown = contents[np.unique(np.linspace(0, len(contents) - 1, _MOST_MAPS).round().astype(int))]
    figure = new_figure(height=4.6)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.6, 1.0))
    maps, curves = figure.add_subfigure(grid[0, 0]), figure.add_subfigure(grid[0, 1])
    panels = maps.subplots(1, len(shown), sharey=True, squeeze=False).ravel()
    values = fields["shear_modulus"].isel(seed=0) * _GPA
    low, high = (float(values.sel(content=shown).quantile(part)) for part in (0.02, 0.98))
    for axes, content in zip(panels, shown, strict=True):
        axes.grid(visible=False)
        image = axes.pcolormesh(
            fields["x"] * MM,
            fields["y"] * MM,
            values.sel(content=content).transpose("y", "x"),
            norm="log",
            vmin=low,
            vmax=max(high, 1.001 * low),
            cmap="viridis",
            rasterized=True,
        )
        axes.set_aspect("equal")
        axes.set_title(f"{content:g} %")
        axes.set_xlabel("x (mm)")
    panels[0].set_ylabel("y (mm)")
    maps.colorbar(image, ax=panels, location="bottom", label="local shear modulus (GPa)", shrink=0.8)
    upper, lower = curves.subplots(2, 1, sharex=True)
    upper.plot(contents, fields["log_deviation"], "o-", color=BLUE, markersize=3)
    upper.set_ylabel("sd of ln G")
    for name, colour in (("x", BLUE), ("y", VERMILION)):
        lower.plot(contents, fields[f"scale_{name}"] * MM, "o-", color=colour, markersize=3, label=f"along {name}")
    lower.axhline(float(fields.attrs["window"]) * MM, color="grey", linestyle=":", label="window")
    lower.set_ylabel("scale of fluctuation (mm)")
    lower.set_xlabel("calcite content (%)")
    lower.legend()
    for axes in (upper, lower):
        axes.set_ylim(bottom=0.0)
    letter_panels([upper, lower])
    return figure
