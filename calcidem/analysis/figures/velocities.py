"""Pictures of velocities: range, distribution, methods and Monte-Carlo error of a campaign; their relation to features.

Also the studies of settings: reading method, damping and excitation frequency.
"""

import math
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from calcidem.analysis.campaign_analysis import (
    CampaignAnalysis,
    LawFit,
    UnavailableError,
    published_velocities,
    ratios_differ,
)
from calcidem.analysis.correlation import Correlations
from calcidem.analysis.distribution import ContentDistribution, Distribution, narrowing
from calcidem.analysis.figures.samples import METHOD_STYLES
from calcidem.analysis.figures.style import (
    BLACK,
    BLUE,
    CONTENT_LABEL,
    CONTENT_MAP,
    FIGURE_WIDTH,
    GREY,
    KHZ,
    MS,
    ORANGE,
    PALE,
    SEQUENCE,
    SKY,
    VERMILION,
    VS_LABEL,
    apply_style,
    letter_panels,
    new_figure,
    new_panel,
    pick_evenly,
)
from calcidem.analysis.fits import VelocityPredictor, power_law
from calcidem.analysis.measured import PublishedVelocity, Target, group_specimens, published_study
from calcidem.analysis.packing_graph import FEATURES, NETWORK_FEATURES
from calcidem.analysis.velocity import are_samples
from calcidem.storage.records import NORMAL_95, depends_on_pulse


@apply_style
def draw_range(
    cells: xr.Dataset,
    distributions: Sequence[ContentDistribution],
    published: Sequence[tuple[float, PublishedVelocity]] = (),
    measured: Sequence[Target] = (),
) -> Figure:
    """Draw Vs against content with its intervals (Fig. 10), published velocities and laboratory samples.

    ``cells`` has vs (m/s), vs_error and pulse_effect along (seed, content), NaN where missing. `UnavailableError` if
    no content has a velocity.
    """
    rows = rows_with_velocity(distributions)
    figure, axes, placed = new_panel(height=4.4)
    close = 0.7  # %; contents up to this are so close together that they have a panel of their own
    low = [row for row in rows if row.content <= close]
    parts = [(axes, rows)]
    if not placed and len(low) > 2 and rows[-1].content > 4 * close:  # fewer need no second picture
        axes.remove()
        left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.6])
        parts = [(left, low), (right, [low[-1], *rows[len(low) :]])]
        left.set_title(f"up to {low[-1].content:g} %")
        right.set_title(f"from {low[-1].content:g} %")
        letter_panels((left, right))
        axes = left
    for panel, shown in parts:
        _draw_range(panel, cells, shown, published)
        # Beyond the campaign's contents, too: the last panel has all above the first.
        ends = (
            low[-1].content if panel is not parts[0][0] else 0.0,
            low[-1].content if panel is not parts[-1][0] else 100.0,
        )
        _draw_measured(panel, [one for one in measured if ends[0] <= one.content <= ends[1]])
        panel.set_ylim(bottom=max(0.0, panel.get_ylim()[0]))  # velocities are positive even if a band is not
        panel.set_xlabel(CONTENT_LABEL if len(parts) == 1 else "calcite content (%)")
    axes.set_ylabel(VS_LABEL)
    if placed:  # other elements of the figure have their own legend
        axes.legend(fontsize=7)
        return figure
    pairs = [pair for panel, _ in parts for pair in zip(*panel.get_legend_handles_labels(), strict=True)]
    legend = {label: handle for handle, label in pairs}
    figure.legend(
        [*legend.values()], [*legend], loc="outside lower center", ncols=3 if len(parts) > 1 and not measured else 2
    )
    return figure


def rows_with_velocity(distributions: Sequence[ContentDistribution]) -> list[ContentDistribution]:
    """Contents with a velocity; `UnavailableError` without any."""
    if found := [row for row in distributions if row.vs.n]:
        return found
    raise UnavailableError("no sample has a velocity")


def _draw_range(
    axes: Axes,
    cells: xr.Dataset,
    rows: Sequence[ContentDistribution],
    published: Sequence[tuple[float, PublishedVelocity]],
) -> None:
    content, means = np.array([(row.content, row.vs.mean) for row in rows]).T
    names = ["vs", "vs_error", "pulse_effect"]
    samples = cells[names].where(xr.DataArray(are_samples(cells["vs"], cells["content"]), cells["vs"].coords))
    columns = [samples.sel(content=at).dropna("seed", subset=["vs"]) for at in content]
    values, errors, effects = ([column[name].to_numpy() for column in columns] for name in names)
    if max(map(len, values)) >= 20:  # of fewer samples quantiles have no meaning
        for share, alpha in ((0.95, 0.3), (0.5, 0.6)):
            ends = (0.5 - share / 2, 0.5 + share / 2)
            low, high = np.array([np.quantile(of_content, ends) for of_content in values]).T
            label = f"{100 * share:g} % of the samples"
            axes.fill_between(content, low, high, color=SKY, alpha=alpha, linewidth=0, label=label)
    else:
        speeds, error = np.concatenate(values), np.concatenate(errors)
        axes.errorbar(
            np.repeat(content, [len(of_content) for of_content in values]),
            speeds,
            yerr=NORMAL_95 * error * speeds,
            fmt="o",
            color=GREY,
            markersize=3,
            elinewidth=0.6,
            label="sample and its 95 % interval" if np.isfinite(error).any() else "sample",
        )
    axes.plot(content, means, color=BLUE, marker="o", markersize=3.5, label="mean")
    limits = np.array([(row.vs.mean_interval.low, row.vs.mean_interval.high) for row in rows]).T
    label = "95 % interval of the mean"
    axes.errorbar(content, means, abs(limits - means), fmt="none", color=BLUE, capsize=3, label=label)
    loud = [bool(depends_on_pulse(effect).any()) for effect in effects]
    if any(loud):
        at, label = content[loud], "depends on the pulse"
        axes.plot(at, means[loud], "o", markersize=8, markerfacecolor="none", color=ORANGE, label=label)
    here = [(at, row) for at, row in published if rows[0].content - 1e-6 <= at <= rows[-1].content + 1e-6]
    if here:
        aside = 0.015 * (content[-1] - content[0])  # so that neither hides the other
        axes.errorbar(
            [at + aside for at, _ in here],
            [row.mean for _, row in here],
            yerr=[row.standard_deviation for _, row in here],
            fmt="D",
            markersize=4,
            markerfacecolor="white",
            color=VERMILION,
            elinewidth=0.9,
            capsize=2,
            zorder=4,
            label="published mean, standard deviation",
        )


def _draw_measured(axes: Axes, measured: Sequence[Target]) -> None:
    """Add laboratory specimens, and means with standard deviations, to a picture of Vs against content."""
    specimens = [row for row in measured if row.samples == 1]
    means = [joined for joined, _ in group_specimens(measured) if joined.samples != 1]
    for rows, mark, label in (
        (specimens, "x", "measured specimen"),
        (means, "s", "measured mean and\nstandard deviation"),
    ):
        if rows:
            axes.errorbar(
                [row.content for row in rows],
                [row.vs for row in rows],
                yerr=[row.sd or math.nan for row in rows],
                fmt=mark,
                markersize=5,
                markerfacecolor="white",
                color=BLACK,
                elinewidth=1.2,
                capsize=3,
                zorder=5,
                label=label,
            )


@apply_style
def draw_histograms(
    vs: xr.DataArray, distributions: Sequence[ContentDistribution], measured: Sequence[Target] = ()
) -> Figure:
    """Draw the distribution of Vs (m/s) at up to 24 contents with its normal fit (Fig. 11), and laboratory means.

    `UnavailableError` if no content has a velocity.
    """
    rows = pick_evenly(rows_with_velocity(distributions), 24)
    columns = min(4, len(rows))
    lines = math.ceil(len(rows) / columns)
    figure = new_figure(height=0.45 + 1.5 * lines)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    marks: list[Line2D] = []
    for axes, row in zip(panels, rows, strict=False):
        values = vs.sel(content=row.content).to_numpy()
        _draw_histogram(axes, values[np.isfinite(values)], row.vs)
        axes.set_title(f"{row.content:g} %")
        for target, _ in group_specimens(measured):
            if math.isclose(target.content, row.content, rel_tol=0.05, abs_tol=1e-6):
                marks.append(axes.axvline(target.vs, color=BLACK, linewidth=1.5, linestyle="--", label="measured mean"))
                low, high = axes.get_xlim()
                axes.set_xlim(min(low, 0.97 * target.vs), max(high, 1.03 * target.vs))
    letter_panels(panels[: len(rows)], fontsize=8.5, pad=19.0)  # space for numbers below
    for axes in panels[len(rows) :]:
        axes.set_axis_off()
    figure.supxlabel(VS_LABEL, fontsize=9)
    figure.supylabel("probability density (own scales)" if lines > 1 else "density (own scales)", fontsize=9)
    if marks:
        figure.legend(handles=marks[:1], loc="outside lower right")
    return figure


def _draw_histogram(axes: Axes, values: NDArray[np.float64], row: Distribution) -> None:
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.xaxis.set_major_locator(MaxNLocator(3, min_n_ticks=2))
    axes.tick_params(labelsize=7)
    if not row.standard_deviation > 0:
        axes.axvline(row.mean, color=BLUE, linewidth=4, alpha=0.7)
        axes.set_xlim(0.9 * row.mean, 1.1 * row.mean)
        text = "one sample" if row.n == 1 else f"all {row.n}\nequal"
        box = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.0}  # above a measured mean
        axes.text(0.05, 0.92, text, transform=axes.transAxes, fontsize=7, va="top", zorder=5, bbox=box)
        return
    # The rule of Freedman and Diaconis gives single bars for small samples, so at least Sturges' number is used.
    axes.hist(values, bins="auto", density=True, color=SKY, alpha=0.75, edgecolor="white", linewidth=0.5)
    reach = 3.4 * row.standard_deviation
    grid = np.linspace(min(values.min(), row.mean - reach), max(values.max(), row.mean + reach), 200)
    axes.plot(grid, row.normal_density(grid), color=VERMILION, linewidth=1.2)
    floor = np.zeros_like(values)
    axes.plot(values, floor, "|", color=BLACK, ms=4, mew=0.5, clip_on=False, rasterized=values.size > 30)
    p_value = row.p_small_sample
    p_text = f"p = {p_value:.2f}" if p_value >= 0.01 else "p < 0.01"  # two digits
    text = f"n = {row.n}, S = {row.skewness:z.2f}, K = {row.kurtosis:z.2f}\n{p_text}".replace("-", "\N{MINUS SIGN}")
    colour = BLACK if p_value >= 0.05 else VERMILION  # the usual level
    axes.text(0, 1.03, text, transform=axes.transAxes, fontsize=6, color=colour)
    axes.set_ylim(0, axes.get_ylim()[1] * 1.05)


@apply_style
def draw_methods(cells: xr.Dataset, measured: Sequence[Target] = ()) -> Figure:
    """Draw mean Vs (m/s) by three methods of reading against content (compare Fig. 6), and laboratory means.

    `UnavailableError` if no cell has a velocity from peak to peak.
    """
    if not bool(np.isfinite(cells["vs_peak"]).any()):
        raise UnavailableError("no sample has a velocity from peak to peak")
    figure = new_figure(height=4.6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1.0])
    content = cells["content"].to_numpy()
    reference = cells["vs_peak"].to_numpy()
    for (name, (label, colour, marker)), width in zip(METHOD_STYLES.items(), (3.6, 2.0, 0.9), strict=True):
        values = cells[f"vs_{name}"].to_numpy()
        ratio = 100 * (values / reference - 1)
        for axes, numbers in ((upper, values), (lower, ratio)):
            known = np.isfinite(numbers).any(axis=0)
            if not known.any():  # no cell has a reading by this method
                continue
            low, middle, high = np.nanquantile(numbers[:, known], [0.1, 0.5, 0.9], axis=0)
            axes.fill_between(content[known], low, high, color=colour, alpha=0.18, linewidth=0)
            # Each curve is thinner than those below it, so that equal curves remain visible.
            axes.plot(content[known], middle, color=colour, lw=width, marker=marker, ms=2.5 + width, label=label)
    _draw_measured(upper, measured)
    upper.set_title("velocity")
    lower.set_title("difference to peak to peak")
    letter_panels((upper, lower))
    upper.set_ylabel(VS_LABEL)
    upper.legend(loc="upper left")
    lower.set_ylabel("difference (%)")
    lower.set_xlabel(CONTENT_LABEL)
    return figure


@apply_style
def draw_narrowing(vs: xr.DataArray, contents: Sequence[float]) -> Figure:
    """Draw the 95 % intervals against the number of seeds for each content, see `distribution.narrowing`; Vs in m/s."""
    counts = tuple(int(count) for count in np.unique(np.geomspace(4, 512, 15).round()))
    narrowings = {content: narrowing(vs.sel(content=content).to_numpy(), counts) for content in contents}
    figure = new_figure(height=3.1)
    panels = figure.subplots(1, 3)
    colours = mpl.colormaps[CONTENT_MAP](np.linspace(0.05, 0.85, len(narrowings)))
    titles = {"mean": "mean\n(m/s)", "standard_deviation": "standard\ndeviation (m/s)", "skewness": "skewness\n(1)"}
    for axes, (name, title) in zip(panels, titles.items(), strict=True):
        for (content, forecast), colour in zip(narrowings.items(), colours, strict=True):
            axes.plot(forecast["count"], forecast[name], color=colour, label=f"{content:g} %")
            axes.axvline(forecast.attrs["present"], color=GREY, linestyle=":", linewidth=1)
        axes.set(xscale="log", yscale="log" if name != "skewness" else "linear", title=title)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_minor_formatter(lambda *_: "")
            axis.set_major_formatter(lambda value, _: f"{value:g}")
    letter_panels(panels)
    panels[0].set_ylabel("half-width of the 95 % interval")
    figure.supxlabel("number of seeds", fontsize=9)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(narrowings))
    return figure


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
                text = f"{value:z.2f}".replace("-", "\N{MINUS SIGN}") if np.isfinite(value) else "\N{EN DASH}"
                colour = "white" if abs(value) > 0.6 else BLACK  # readable on dark red and blue
                axes.text(column, row, text, ha="center", va="center", fontsize=6.2, color=colour)
        labels = [_symbol(name) for name in names]
        axes.set_xticks(range(len(names)), labels, fontsize=8)
        axes.set_yticks(range(len(names)), labels, fontsize=8)
        axes.tick_params(length=0, top=False, labeltop=True, bottom=False, labelbottom=False)
        axes.spines[:].set_visible(False)
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
    label = r"weight ratio $\omega_{LPB}\,/\,\omega_h$"
    axes.set(xlim=(0, 1), xlabel=label, ylabel="correlation of $C_{d,n}$ with $V_s$")
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
    label = "conductance $G$ of the network, over that with all contacts cemented"
    axes.set(xscale="log", yscale="log", xlabel=label, ylabel=VS_LABEL)
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
    ends = f"{fit.b_interval.low:z.1f} to {fit.b_interval.high:z.1f}".replace("-", "\N{MINUS SIGN}")
    few = f"\n(few samples: $b$ = {ends})"
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


_FREQUENCY_LABEL = "excitation frequency (kHz)"
_SHOWN_METHODS = ("peak", "first_arrival")


@apply_style
def draw_reading_study(study: xr.Dataset) -> Figure:
    """Draw Vs from peak to peak and by first arrival against frequency (Fig. 6).

    Marks are hollow where transmitter and receiver are less than a wavelength apart.
    """
    contents = study["content"].to_numpy()
    lines = math.ceil(len(contents) / 2)
    figure = new_figure(height=0.6 + 2.1 * lines)
    panels = figure.subplots(lines, min(2, len(contents)), squeeze=False, sharex=True).ravel()
    frequency = study["frequency"].to_numpy() * KHZ
    for axes, content in zip(panels, contents, strict=False):
        for name in _SHOWN_METHODS:
            label, colour, marker = METHOD_STYLES[name]
            values = study[f"vs_{name}"].sel(content=content).transpose("seed", "frequency").to_numpy()
            axes.plot(frequency, values.T, color=colour, alpha=0.25, linewidth=0.7)
            known, values = _where_complete(values)
            mean = values.sum(axis=0) / len(values)  # also of none
            axes.plot(frequency[known], mean, color=colour, marker=marker, markersize=4, label=label)
            near = study.attrs["distance"] * frequency[known] / KHZ < mean
            axes.plot(
                frequency[known][near],
                mean[near],
                linestyle="none",
                color=colour,
                marker=marker,
                markersize=4,
                markerfacecolor="white",
                zorder=3,
            )
        axes.set_title(f"{content:g} %")
        _start_at_zero(axes)
    letter_panels(panels[: len(contents)])
    for axes in panels[len(contents) :]:
        axes.set_axis_off()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(_SHOWN_METHODS))
    figure.supxlabel(_FREQUENCY_LABEL, fontsize=9)
    figure.supylabel(VS_LABEL, fontsize=9)
    return figure


def _where_complete(values: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Frequencies at which every sample has a value, of those that have any, and these values (samples, frequencies).

    A mean over fewer samples would move because they differ.
    """
    values = values[np.isfinite(values).any(axis=1)]
    known: NDArray[np.bool_] = np.logical_and(np.isfinite(values).all(axis=0), len(values) > 0)
    return known, values[:, known]


@apply_style
def draw_frequency_study(study: xr.Dataset) -> Figure:
    """Draw received frequency and Vs against transmitted frequency (Fig. 9)."""
    figure = new_figure(height=3.5, width=7.0)
    left, right = figure.subplots(1, 2)
    frequency = study["frequency"].to_numpy() * KHZ
    left.plot(frequency, frequency, color=GREY, linestyle=":", linewidth=1.2, label="equal")
    count = study.sizes["content"]
    for place, (content, colour) in enumerate(zip(study["content"].to_numpy(), SEQUENCE, strict=False)):
        for axes, name, scale in ((left, "received_frequency", KHZ), (right, "vs_peak", 1.0)):
            values = study[name].sel(content=content).transpose("seed", "frequency").to_numpy() * scale
            known, values = _where_complete(values)
            ends = values.min(axis=0, initial=np.inf), values.max(axis=0, initial=0.0)
            axes.fill_between(frequency[known], *ends, color=colour, alpha=0.15, linewidth=0)
            mean = values.sum(axis=0) / len(values)
            axes.plot(frequency[known], mean, color=colour, marker="o", markersize=3.5, label=f"{content:g} %")
        used = float(study["campaign_frequency"].sel(content=content)) * KHZ
        dashes = (4 * place, (4, 4 * count))  # those of equal frequencies follow one another
        right.axvline(used, color=colour, linestyle=dashes, linewidth=1.0)
    letter_panels((left, right))
    for axes in (left, right):
        axes.set_xlabel(_FREQUENCY_LABEL)
        _start_at_zero(axes)
    left.set_ylabel("frequency received (kHz)")
    right.set_ylabel(VS_LABEL)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=1 + count)
    return figure


@apply_style
def draw_damping_study(study: xr.Dataset) -> Figure:
    """Draw received signals for several damping factors (Fig. 7), and the arrival by the published mean velocity."""
    contents = study["content"].to_numpy()
    published = dict(published_study().velocities) if study.attrs.get("published") else {}
    factors = study["damping"].to_numpy()
    figure = new_figure(height=0.7 + 2.9 * len(contents), width=FIGURE_WIDTH + 0.4)
    panels = figure.subplots(len(contents), 2, squeeze=False, width_ratios=[2.2, 1.0])
    colours = mpl.colormaps[CONTENT_MAP](np.linspace(0.0, 0.9, len(factors)))
    for (signals, velocities), content in zip(panels, contents, strict=True):
        chosen = study.sel(content=content)
        time = chosen["time"].to_numpy() * MS
        received = chosen["received"].transpose("damping", ...).to_numpy()
        received = received / np.abs(received).max()
        step = float(np.diff(received, axis=0).max(initial=0.0)) + 0.1  # so that no curve meets its neighbour
        starts, path = 0.5 / float(chosen["frequency"]), study.attrs["distance"]  # at the peak of the pulse
        arrivals = starts + path / chosen["vs_peak"].to_numpy()
        if content in published:
            arrival = starts + path / published[content].mean
            signals.axvline(arrival * MS, color=VERMILION, linestyle="--", linewidth=1.0, label="by the published mean")
            signals.legend(loc="upper right", fontsize=7)
        for place, (factor, signal, colour) in enumerate(zip(factors, received, colours, strict=True)):
            level = np.interp(arrivals[place] * MS, time, signal) - step * place
            signals.plot(arrivals[place] * MS, level, "v", color=colour, markersize=5)
            signals.plot(time, signal - step * place, color=colour, linewidth=1.2)
            signals.annotate(
                f"{factor:g}",
                (time[-1], -step * place),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
                color=colour,
                annotation_clip=False,
            )
        signals.set(yticks=[], xlim=(0, time[-1]), ylabel="received, by damping factor", title=f"{content:g} %")
        velocities.plot(factors, chosen["vs_peak"].transpose("damping", ...), color=BLUE, marker="o", markersize=3.5)
        velocities.set_ylabel(VS_LABEL)
        _start_at_zero(velocities)
        velocities.set_xlim(0, 1.08 * factors[-1])
    letter_panels(panels.ravel())
    panels[-1, 0].set_xlabel("time (ms)")
    panels[-1, 1].set_xlabel("damping factor")
    return figure


def _start_at_zero(axes: Axes) -> None:
    """Let a vertical axis begin at zero, with some space above the data."""
    axes.set_ylim(0, 1.06 * axes.get_ylim()[1])
