"""Figures 1, 3 and 8 of the paper; `python docs/gallery/make_gallery.py` draws them from the preset `quick`."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, ConnectionPatch, Polygon, Rectangle

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.figures.samples import (
    COLOURS,
    draw_bands,
    draw_frame,
    draw_grains,
    draw_signal_pair,
    load_arrival,
)
from calcidem.analysis.figures.style import (
    BLACK,
    BLUE,
    CONTENT_LABEL,
    GREEN,
    GREY,
    MM,
    SKY,
    VERMILION,
    VS_LABEL,
    FigureEntry,
    apply_style,
    letter_panels,
    new_figure,
    new_panel,
    strip_axes,
)
from calcidem.analysis.measured import published_study
from calcidem.dem.sample.cement import toroid_area
from calcidem.dem.wave.section import clamp_of_strip
from calcidem.storage.records import RecordedSection, Selection

SHOWN_CONTENT = 2.55  # percent


@apply_style
def draw_method(analysis: CampaignAnalysis) -> Figure:
    """Draw the method in four steps, on the slowest and the fastest sample of a content (Fig. 1)."""
    graph, wave = analysis.graphs[0], analysis.config["wave"]
    packing, ordered = graph.packing, analysis.measured_samples(SHOWN_CONTENT)
    chosen = {ordered[0].seed: (ordered[0], BLUE), ordered[-1].seed: (ordered[-1], VERMILION)}
    figure = new_figure(height=5.0, width=9.6)
    grid = figure.add_gridspec(2, 4, width_ratios=[1.0, 1.05, 1.25, 1.55])
    box = figure.add_subplot(grid[:, 0])
    draw_grains(box, graph)
    draw_frame(box, packing)
    draw_bands(box, packing, wave["transmitter_half_width"], wave["receiver_half_width"])
    for x, name, colour in ((-0.06, "transmitter", VERMILION), (1.06, "receiver", GREEN)):
        look = {"rotation": 90, "ha": "right" if x < 0 else "left", "va": "center", "color": colour}
        box.text(x * packing.width * MM, packing.height / 2 * MM, name, **look)
    layer = wave["boundary_thickness"] * MM
    for bottom in (0.0, packing.height * MM - layer):
        box.add_patch(Rectangle((0, bottom), packing.width * MM, layer, facecolor=GREY, alpha=0.45, zorder=3))
        box.text(packing.width / 2 * MM, bottom + layer / 2, "damped", ha="center", va="center", zorder=4)
    box.set_title(f"{packing.radius.size:,} disks")
    half, low = 0.11 * packing.width, 0.5 * packing.height
    corner = ((packing.width / 2 - half) * MM, (low - half) * MM)
    box.add_patch(Rectangle(corner, 2 * half * MM, 2 * half * MM, fill=False, edgecolor=BLACK, zorder=6))
    rows = []
    for line, (seed, (sample, colour)) in enumerate(chosen.items()):
        cement, signals = figure.add_subplot(grid[line, 1]), figure.add_subplot(grid[line, 2])
        draw_grains(cement, graph, sample.kinds, low=low - 2 * half, high=low + 2 * half, cement_width=2.6)
        cement.set_xlim(corner[0], corner[0] + 2 * half * MM)
        cement.set_ylim(corner[1], corner[1] + 2 * half * MM)
        cement.set_title(f"seed {seed}, {SHOWN_CONTENT:g} %")
        draw_signal_pair(signals, load_arrival(analysis, seed, SHOWN_CONTENT))
        signals.set_title(f"wave: {sample.vs:.0f} m/s", color=colour)
        signals.set_xlabel("time (ms)")
        rows.append((cement, signals))
    result = figure.add_subplot(grid[:, 3])
    vs = analysis.distinct["vs"]
    result.plot(vs["content"], vs.T, ".", color=GREY, markersize=5, label=["sample", *[""] * (vs.sizes["seed"] - 1)])
    result.plot(vs["content"], vs.mean("seed"), color=BLACK, label="mean")
    for seed, (sample, colour) in chosen.items():
        result.plot(SHOWN_CONTENT, sample.vs, "o", color=colour, markersize=8, label=f"seed {seed}")
    result.set(xlabel="calcite content (%)", ylabel=VS_LABEL)
    result.set_title(f"{int(vs.notnull().sum())} velocities")
    result.legend(loc="upper left")
    handles, labels = rows[0][1].get_legend_handles_labels()
    colours = [Rectangle((0, 0), 1, 1, facecolor=colour) for colour in COLOURS.values()]
    figure.legend([*colours, *handles], [*COLOURS, *labels], loc="outside lower center", ncols=5)
    letter_panels([box, *rows[0], *rows[1], result])
    for cement, _ in rows:
        ends = {"xyA": (corner[0] + 2 * half * MM, corner[1] + half * MM), "xyB": (0.0, 0.5)}
        places = {"coordsA": box.transData, "coordsB": cement.transAxes}
        figure.add_artist(ConnectionPatch(**ends, **places, arrowstyle="->", color=BLACK, linewidth=1.2, zorder=9))
    return figure


@apply_style
def draw_cement_volume(_: CampaignAnalysis) -> Figure:
    """Draw the cement between the smallest and the largest disk by Eq. 2 (Fig. 3)."""
    parameters = published_study().parameters
    diameters = [parameters[f"grain_diameter_{size}"] * MM for size in ("smallest", "largest")]
    width = parameters["single_precipitate_larger"] * MM
    figure, axes, _ = new_panel(height=3.2, width=5.2)
    angle = np.linspace(-1.0, 1.0, 101)
    arcs, heights = [], []
    for diameter, side, number in zip(diameters, (-1.0, 1.0), (1, 2), strict=True):
        radius = diameter / 2
        axes.add_patch(Circle((side * radius, 0), radius, facecolor=COLOURS["sand grain"], edgecolor=GREY))
        turn = angle * np.arcsin(width / diameter)
        arcs.append(np.column_stack([side * radius * (1 - np.cos(turn)), radius * np.sin(turn)]))
        heights.append(arcs[-1][-1, 0])
        axes.text(side * radius, -0.12 * radius, f"$d_{number}$ = {diameter:g} mm", ha="center", va="top")
        axes.plot([side * radius], [0], "+", color=GREY)
        axes.annotate(
            "",
            (0, 0.72 * width),
            (heights[-1], 0.72 * width),
            arrowprops={"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0},
        )
        axes.text(heights[-1] * 1.2, 0.72 * width, f"$h_{number}$", ha="right" if side < 0 else "left", va="center")
        axes.plot([heights[-1]] * 2, [width / 2, 0.8 * width], color=BLACK, linewidth=0.6)
    outline = np.concatenate([arcs[0], arcs[1][::-1]])
    axes.add_patch(Polygon(outline, facecolor=COLOURS["C contact"], alpha=0.85, zorder=3))
    axes.axvline(0.0, color=GREY, linewidth=0.6, linestyle=":")
    axes.annotate(
        "",
        (0.0, -width / 2),
        (0.0, width / 2),
        arrowprops={"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0, "color": "white"},
        zorder=5,
    )
    axes.annotate(
        f"$d_c$ = {width:g} mm",
        (0.0, -0.3 * width),
        (-0.5 * diameters[0], -0.48 * diameters[1]),
        ha="center",
        va="center",
        arrowprops={"arrowstyle": "-", "linewidth": 0.6},
    )
    area = float(toroid_area(*diameters, width))
    axes.set_title(f"$v = d_c\\,(h_1 + h_2) - (S_1 + S_2)$ = {area:.3f} mm³ for 1 mm of depth")
    strip_axes(axes)
    axes.set_aspect("equal")
    axes.set_xlim(-1.04 * diameters[0], 1.04 * diameters[1])
    axes.set_ylim(-0.6 * diameters[1], 0.6 * diameters[1])
    return figure


@apply_style
def draw_damping_ratio(analysis: CampaignAnalysis) -> Figure:
    """Draw the damping ratio between the stations of each sample against content (Fig. 8)."""
    wave, height = analysis.config["wave"], analysis.graphs[0].packing.height
    clamp = clamp_of_strip(height - 2.0 * wave["boundary_thickness"])
    figure, axes, _ = new_panel(height=3.4)
    found: dict[float, list[float]] = {}
    for cell in analysis.store.results(Selection(), with_arrays=("section",)):
        if cell.section is not None and cell.effective_vs is not None:
            ratios = found.setdefault(cell.key.content, [])
            if cell.key.content or not ratios:  # without cement all seeds are one sample
                ratios.append(spectral_damping_ratio(cell.section, cell.effective_vs, clamp))
    axes.axhspan(0.02, 0.15, color=SKY, alpha=0.25, linewidth=0, label="cemented sands, as the paper quotes")
    label = "sample"
    for content, ratios in found.items():
        axes.plot([content] * len(ratios), ratios, ".", color=GREY, markersize=5, label=label)
        label = ""
    axes.plot(list(found), [np.mean(ratios) for ratios in found.values()], "o-", color=BLUE, label="mean")
    nominal = wave["damping"] / np.pi
    axes.axhline(nominal, color=VERMILION, linestyle="--", label=f"$\\alpha / \\pi$ = {nominal:.3f}")
    axes.set(xlabel=CONTENT_LABEL, ylabel="damping ratio between stations")
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    figure.legend(loc="outside lower center", ncols=4, fontsize=7)
    return figure


def spectral_damping_ratio(section: RecordedSection, velocity: float, clamp: float) -> float:
    """Damping ratio D by spectral ratios of the stations: of a wave exp(-g x), g^2 = (s (1 - i D) / c)^2 + K^2.

    Transforms are taken at s = f / 2 + 2 pi i f with the frequency f of the pulse; c is the velocity (m/s) and K the
    clamp (1/m) of docs/velocity.md. The logarithm of their size falls along the path by Re g(0) and D times the
    derivative of Re g, least squares over all stations. So D contains whatever else takes amplitude from a wave.
    """
    s = section.pulse_frequency * (0.5 + 2j * np.pi)
    transforms = np.exp(-s * section.time) @ section.across
    free = np.sqrt((s / velocity) ** 2 + clamp**2)
    lost = np.log(np.abs(transforms)) + free.real * section.places
    return float(-np.polyfit(section.places, lost, 1)[0] / ((s / velocity) ** 2 / 1j / free).real)


PAPER_FIGURES = (
    FigureEntry(
        "method",
        "The method (Fig. 1)",
        "One packing, cement at random places by seed, a wave through each sample, and the velocities of all.",
        draw_method,
        pictorial=True,
    ),
    FigureEntry(
        "cement_volume",
        "Cement of a contact (Fig. 3)",
        "Between two disks, as wide as d_c, less the segments S of the disks: Eq. 2.",
        draw_cement_volume,
    ),
    FigureEntry(
        "damping_ratio",
        "Damping ratio (Fig. 8)",
        "Loss of amplitude between the stations of a section. It contains what patches of cement scatter.",
        draw_damping_ratio,
    ),
)
"""Drawn for the gallery alone."""
