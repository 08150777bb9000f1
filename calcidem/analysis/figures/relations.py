"""Figures of the relation between paths and Vs: correlations, the weight scan and the laws."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from calcidem.analysis.campaign_analysis import CampaignAnalysis, LawFit, published_velocities, ratios_differ
from calcidem.analysis.correlation import Correlations
from calcidem.analysis.figures.style import (
    BLACK,
    BLUE,
    CONTENT_MAP,
    PALE,
    SKY,
    VERMILION,
    VS_LABEL,
    apply_style,
    letter_panels,
    new_figure,
    new_panel,
)
from calcidem.analysis.fits import VelocityPredictor, power_law
from calcidem.analysis.measured import published_study
from calcidem.analysis.packing_graph import FEATURES, NETWORK_FEATURES


def _symbol(name: str) -> str:
    """Return the symbol of a variable as mathematical text, such as ``$C_{d,n}$``."""
    symbols = {name: symbol for name, (symbol, _) in (FEATURES | NETWORK_FEATURES).items()} | {"vs": "V_s"}
    base, _, index = symbols[name].partition("_")
    upright = f"\\mathrm{{{base}}}" if len(base) > 1 else base
    return f"${upright}_{{{index}}}$" if index else f"${upright}$"


@apply_style
def draw_correlations(correlations: Correlations) -> Figure:
    """Draw the correlation matrices of features and Vs over all contents and within one (Fig. 13a)."""
    figure = new_figure(height=3.95, width=7.4)
    panels = figure.subplots(1, 2)
    titles = ("over all contents", "within one content")
    for axes, matrices, title in zip(panels, (correlations.overall, correlations.within), titles, strict=True):
        names = [str(name) for name in matrices["variable"].to_numpy()]
        below = np.tri(len(names), dtype=np.bool_)
        values = np.where(below, matrices["pearson"].to_numpy(), matrices["spearman"].to_numpy())
        axes.set_facecolor(PALE)
        image = axes.imshow(values, cmap="RdBu_r", vmin=-1, vmax=1)
        axes.grid(visible=False)
        for (row, column), value in np.ndenumerate(values):
            if row != column:
                text = f"{value:.2f}".replace("-", "\N{MINUS SIGN}") if np.isfinite(value) else "\N{EN DASH}"
                colour = "white" if abs(value) > 0.6 else BLACK  # readable on dark red and blue
                axes.text(column, row, text, ha="center", va="center", fontsize=6.2, color=colour)
        labels = [_symbol(name) for name in names]
        axes.set_xticks(range(len(names)), labels, fontsize=8)
        axes.set_yticks(range(len(names)), labels, fontsize=8)
        axes.tick_params(length=0, top=False, labeltop=True, bottom=False, labelbottom=False)
        for spine in axes.spines.values():
            spine.set_visible(False)
        axes.set_title(f"{title} (n = {int(matrices['n'])})", pad=18)
    letter_panels(panels)
    panels[1].tick_params(labelleft=False)
    colour_bar = figure.colorbar(image, ax=panels, location="bottom", shrink=0.5, aspect=40, pad=0.03)
    colour_bar.set_label("below the diagonal Pearson's coefficient, above it Spearman's")
    colour_bar.outline.set_edgecolor("none")
    return figure


@apply_style
def draw_ratio_scan(analysis: CampaignAnalysis) -> Figure:
    """Draw the correlation of C_d,n with Vs over the ratio of the weights (Fig. 14), and the published best."""
    scan = analysis.ratio_scan
    figure, axes, _ = new_panel(height=3.4)
    interval = scan.best_ratio_interval
    axes.axvspan(interval.low, interval.high, color=SKY, alpha=0.3, linewidth=0, label="95 % interval of the best")
    axes.plot(scan.ratios, scan.correlation, color=BLUE)
    best = f"best: {scan.best_ratio:.2f} (r = \N{MINUS SIGN}{abs(scan.best_correlation):.3f})"
    axes.plot(scan.best_ratio, scan.best_correlation, "o", color=BLUE, markersize=6, label=best)
    if published_velocities(analysis):
        ratio = next(law.weights.ratio for law in published_study().laws if law.name == "Monte-Carlo")
        axes.axvline(ratio, color=VERMILION, linestyle="--", label=f"published best: {ratio:g}")
    axes.set_xlim(0, 1)
    axes.set_xlabel(r"weight ratio $\omega_{LPB}\,/\,\omega_h$")
    axes.set_ylabel("correlation of $C_{d,n}$ with $V_s$")
    axes.legend(loc="best")
    return figure


@apply_style
def draw_laws(analysis: CampaignAnalysis) -> Figure:
    """Draw Vs against C_d,n with the fitted law, a panel for each choice of weights (Table 4).

    Published laws are shown in their own range, where C_d,n has the same weights.
    """
    contents = np.array([sample.content for sample in analysis.samples])
    (laws, published), vs = analysis.compared_laws, analysis.sample_vs
    figure = new_figure(height=4.1, width=3.4 + 2.0 * len(laws))
    panels = figure.subplots(1, len(laws), sharey=True)
    for axes, law in zip(panels, laws, strict=True):
        points, grid = _draw_law(axes, law, "C_{d,n}", vs, contents)
        for other in published:
            if not ratios_differ(law, other):
                span = np.linspace(max(other.connectivity_range.low, grid[0]), other.connectivity_range.high, 200)
                label = "published: " + _law_text("C_{d,n}", other.a, other.conclusions_b, other.c)
                vs_of_law = power_law(span, other.a, other.conclusions_b, other.c)
                axes.plot(span, vs_of_law, color=VERMILION, linestyle="--", label=label)
        axes.set_title(f"weights by {law.name}")
        if law.weights:
            weights = f"$\\omega_h$ = {law.weights.hertz:.3f}, $\\omega_{{LPB}}$ = {law.weights.bond:.3f}"
            axes.set_xlabel(f"$C_{{d,n}}$ with {weights}")
        axes.legend(loc="upper right", fontsize=7)
        axes.set_ylim(0, 1.25 * np.nanmax(vs))
    letter_panels(panels)
    panels[0].set_ylabel(VS_LABEL)
    _add_contents(figure, points, panels)
    return figure


@apply_style
def draw_conductance(analysis: CampaignAnalysis) -> Figure:
    """Draw Vs against the conductance of the cement as a network, with the fitted law."""
    contents = np.array([sample.content for sample in analysis.samples])
    figure, axes, _ = new_panel(height=4.1)
    points, _ = _draw_law(axes, analysis.conductance_law, "G", analysis.sample_vs, contents)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("conductance $G$ of the network, over that with all contacts cemented")
    axes.set_ylabel(VS_LABEL)
    axes.legend(loc="upper left", fontsize=7)
    _add_contents(figure, points, axes)
    return figure


def _draw_law(
    axes: Axes, law: LawFit, symbol: str, vs: NDArray[np.float64], contents: NDArray[np.float64]
) -> tuple[PathCollection, NDArray[np.float64]]:
    """Draw samples, law, and the interval of new samples at each content; returns the points and places of the law."""
    size = 7 if len(vs) > 200 else 20  # points²
    points = axes.scatter(
        law.connectivity, vs, c=contents, cmap=CONTENT_MAP, s=size, alpha=0.8, linewidths=0, rasterized=True
    )
    known = law.connectivity[np.isfinite(vs)]
    grid = np.linspace(np.nanmin(known), np.nanmax(known), 200)
    outlined = [Stroke(linewidth=2.6, foreground="white"), Normal()]
    bars: dict[str, Any] = {"color": BLACK, "linewidth": 1.0, "path_effects": outlined, "zorder": 3}
    if (intervals := _intervals_by_content(law.connectivity, vs, contents)).size:
        axes.vlines(*intervals.T, **bars, label="95 % of new samples at each content")
    fit = law.fit
    few = f"\n(few samples: $b$ = {fit.b_interval.low:.1f} to {fit.b_interval.high:.1f})".replace("-", "\N{MINUS SIGN}")
    label = _law_text(symbol, fit.a, fit.b, fit.c) + few * (fit.n < 30)
    axes.plot(grid, fit.predict(grid), color=BLUE, zorder=4, label=label)
    return points, grid


def _add_contents(figure: Figure, points: PathCollection, axes: Axes | NDArray[np.object_]) -> None:
    """Add the colour bar of the contents."""
    colour_bar = figure.colorbar(
        mpl.cm.ScalarMappable(norm=points.norm, cmap=points.cmap), ax=axes, pad=0.01, aspect=35
    )
    colour_bar.set_label("calcite content (%)")
    colour_bar.outline.set_edgecolor("none")


def _intervals_by_content(
    connectivity: NDArray[np.float64], vs: NDArray[np.float64], contents: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mean connectivity of each content, and ends of the predicted interval there (m/s), (contents, 3)."""
    found = []
    for content in np.unique(contents):
        known = (contents == content) & np.isfinite(vs) & np.isfinite(connectivity)
        if known.sum() < 10:  # intervals of fewer are wider than the picture
            continue
        mean = float(np.mean(connectivity[known]))
        interval = VelocityPredictor.fit(connectivity[known, None], vs[known]).predict([mean]).interval
        found.append((mean, interval.low, interval.high))
    return np.array(found, dtype=np.float64).reshape(-1, 3)


def _law_text(symbol: str, a: float, b: float, c: float) -> str:
    """Return a law of a symbol as mathematical text."""
    sign = "\N{MINUS SIGN}" if c < 0 else "+"
    return f"$V_s = {a:.0f}\\,{symbol}^{{{b:.2f}}}$ {sign} {abs(c):.0f} m/s"
