"""Pictures of samples: cement, transmission of the wave, preferential paths, and the wave as moving pictures."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import FuncNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray
from PIL import Image

from calcidem.analysis.campaign_analysis import MeasuredSample
from calcidem.analysis.figures.signals import METHOD_STYLES, Arrival, draw_signal_pair
from calcidem.analysis.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    MM,
    MS,
    PALE,
    PURPLE,
    VERMILION,
    apply_style,
    letter_panels,
    new_figure,
    new_panel,
    strip_axes,
)
from calcidem.analysis.packing_graph import PackingGraph
from calcidem.storage.errors import OutputRefusedError
from calcidem.storage.records import C_CONTACT, P_CONTACT, PackingRecord

COLOURS = {"sand grain": "#d3e0ea", "grain in a C cluster": "#f6c667", "P contact": BLUE, "C contact": "#a63603"}
"""Colour of each part of a sample, by its name in the legend; grains and cement differ in brightness."""

_RING: dict[str, Any] = {"markerfacecolor": "white", "markeredgecolor": PURPLE, "markeredgewidth": 1.3}
"""Look of an uncemented contact on a path."""


def draw_grains(
    axes: Axes,
    sample: PackingGraph,
    kinds: NDArray[np.uint8] | None = None,
    *,
    low: float = -np.inf,
    high: float = np.inf,
    cement_width: float = 1.0,
) -> None:
    """Draw the grains between two heights, m, and the cement between them, on axes without ticks.

    ``kinds`` (m,) are 0 (sand), 1 (P) or 2 (C) of each contact; the width of cemented contacts is in points.
    """
    packing, pairs = sample.packing, sample.graph.pairs
    chosen = (packing.y > low) & (packing.y < high)
    in_cluster = np.zeros(packing.radius.size, dtype=np.bool_)
    if kinds is not None:
        in_cluster[pairs[kinds == C_CONTACT]] = True
    for members, name in ((chosen & ~in_cluster, "sand grain"), (chosen & in_cluster, "grain in a C cluster")):
        # Thousands of circles are drawn as pixels in vector files, which keeps these small.
        diameters = 2.0 * packing.radius[members] * MM
        axes.add_collection(
            EllipseCollection(
                diameters,
                diameters,
                0.0,
                units="xy",
                offsets=np.column_stack([packing.x[members], packing.y[members]]) * MM,
                offset_transform=axes.transData,
                facecolor=COLOURS[name],
                edgecolor="white",
                linewidth=0.25,
                rasterized=True,
            )
        )
    if kinds is not None:
        inside = chosen[pairs].all(axis=1)
        for kind, name in ((P_CONTACT, "P contact"), (C_CONTACT, "C contact")):
            ends = pairs[inside & (kinds == kind)].T
            first, second = (np.column_stack([packing.x[grains], packing.y[grains]]) for grains in ends)
            # A stroke around each contact point is half as long as the distance of the two centres.
            strokes = np.stack([0.75 * first + 0.25 * second, 0.25 * first + 0.75 * second], axis=1) * MM
            look: dict[str, Any] = {"colors": COLOURS[name], "linewidths": cement_width, "rasterized": True}
            axes.add_collection(LineCollection(list(strokes), **look))
    strip_axes(axes)
    axes.set_aspect("equal")
    bottom, top = max(low, 0.0) * MM, min(high, packing.height) * MM
    margin = 0.015 * packing.width * MM  # for the line of the frame
    axes.set_xlim(-margin, packing.width * MM + margin)
    axes.set_ylim(bottom - margin, top + margin)


def draw_frame(axes: Axes, packing: PackingRecord) -> None:
    """Draw the rigid walls of the box."""
    frame = Rectangle((0, 0), packing.width * MM, packing.height * MM, fill=False, edgecolor=BLACK, linewidth=0.8)
    axes.add_patch(frame)


def draw_bands(axes: Axes, packing: PackingRecord, transmitter: float, receiver: float) -> None:
    """Draw the bands of the side walls that transmit and receive, of these half-widths in m."""
    middle, width = packing.height / 2, packing.width
    for x, half, colour in ((0.0, transmitter, VERMILION), (width, receiver, GREEN)):
        axes.plot(
            [x * MM, x * MM],
            [(middle - half) * MM, (middle + half) * MM],
            color=colour,
            linewidth=4.0,
            solid_capstyle="butt",
            zorder=5,
        )


@apply_style
def draw_cemented_samples(graph: PackingGraph, samples: Sequence[MeasuredSample]) -> Figure:
    """Draw two to four samples of one seed side by side, and below each an enlarged part (Figs. 2c, 2d and 5)."""
    packing = graph.packing
    # The enlarged part is 17 mean radii wide, so that single contacts are seen.
    middle, half = packing.height / 2, min(8.5 * float(packing.radius.mean()), packing.height / 4)
    figure = new_figure(height=7.6)
    detail_share = 1.05 * packing.width / packing.height  # of the height of a whole sample, for a square as wide
    grid = figure.subplots(
        2, len(samples), squeeze=False, height_ratios=[1.0, min(1.0, detail_share)], gridspec_kw={"hspace": 0.03}
    )
    left = packing.width / 2 - half
    for axes, sample in zip(grid[0], samples, strict=True):
        draw_grains(axes, graph, sample.kinds, cement_width=0.7)
        draw_frame(axes, packing)
        axes.set_title(f"{sample.content:g} %")
        corner = (left * MM, (middle - half) * MM)
        axes.add_patch(Rectangle(corner, 2 * half * MM, 2 * half * MM, fill=False, edgecolor=BLACK, linewidth=1.1))
    for axes, sample in zip(grid[1], samples, strict=True):
        draw_grains(axes, graph, sample.kinds, low=middle - 1.3 * half, high=middle + 1.3 * half, cement_width=2.4)
        axes.set_xlim(left * MM, (left + 2 * half) * MM)
        axes.set_ylim((middle - half) * MM, (middle + half) * MM)
        for spine in axes.spines.values():
            spine.set_visible(True)
            spine.set_linewidth(1.1)
            spine.set_edgecolor(BLACK)
    letter_panels(grid.ravel())
    _draw_scale(grid[0][0], 0.0, 0.0, packing.width * MM)
    _draw_scale(grid[1][0], left * MM, (middle - half) * MM, 2 * half * MM)
    figure.legend(handles=_legend_handles(), loc="outside lower center", ncols=4)
    return figure


@apply_style
def draw_measurement(graph: PackingGraph, wave: Mapping[str, Any], arrival: Arrival | None) -> Figure:
    """Draw transmitter, receiver and, if given, an example of both signals (Fig. 4).

    ``wave`` is the section ``[wave]`` of the configuration, with lengths in m.
    """
    packing = graph.packing
    width, height = packing.width * MM, packing.height * MM
    transmitter, receiver = float(wave["transmitter_half_width"]), float(wave["receiver_half_width"])
    layer = float(wave.get("boundary_thickness", 0.0)) * MM
    if arrival is None:
        figure, scene, _ = new_panel(height=4.4, width=3.4)
    else:
        figure = new_figure(height=4.4)
        scene, signals = figure.subplots(1, 2, width_ratios=[1.0, 1.35])
    draw_grains(scene, graph)
    for bottom in (0.0, height - layer):
        scene.add_patch(Rectangle((0, bottom), width, layer, facecolor=GREY, alpha=0.45, linewidth=0, zorder=3))
        scene.text(width / 2, bottom + layer / 2, "strongly damped", ha="center", va="center", fontsize=7, zorder=4)
    draw_frame(scene, packing)
    draw_bands(scene, packing, transmitter, receiver)
    scene.set_xlim(-0.32 * width, 1.32 * width)
    arrow = {"arrowstyle": "<->", "color": VERMILION, "linewidth": 1.6}
    reach = max(transmitter * MM * 2.2, 0.07 * height)
    scene.annotate("", (-0.08 * width, height / 2 + reach), (-0.08 * width, height / 2 - reach), arrowprops=arrow)
    scene.text(-0.14 * width, height / 2, "transmitter", rotation=90, ha="right", va="center", color=VERMILION)
    scene.text(1.07 * width, height / 2, "receiver", rotation=270, ha="left", va="center", color=GREEN)
    # The path of a velocity lies between the grains at both walls; without one the width is shown.
    path = width if arrival is None else arrival.distance * MM
    ends = [((width + side * path) / 2, 0.33 * height) for side in (1.0, -1.0)]
    arrow = {"arrowstyle": "<->", "color": BLACK, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
    scene.annotate("", ends[0], ends[1], arrowprops=arrow, zorder=9)
    label = f"width {width:.3g} mm" if arrival is None else f"L = {path:.3g} mm"
    box = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.5}
    scene.text(width / 2, 0.335 * height, label, ha="center", va="bottom", zorder=9, bbox=box)
    _draw_scale(scene, 0.0, 0.0, width)
    if arrival is not None:
        draw_signal_pair(signals, arrival)
        signals.set_title(f"seed {arrival.seed} at {arrival.content:g} %")
        letter_panels((scene, signals))
        signals.set_xlabel("time (ms)")
        signals.set_box_aspect(1.0)
        read = {METHOD_STYLES[method][0]: f": {velocity:.0f} m/s" for method, velocity in arrival.velocities.items()}
        handles, labels = signals.get_legend_handles_labels()
        labels = [label + read.get(label, "") for label in labels]
        figure.legend(handles, labels, loc="outside lower right", ncols=2)
    return figure


@apply_style
def draw_preferential_paths(graph: PackingGraph, samples: Sequence[MeasuredSample]) -> Figure:
    """Draw samples of one content, from slow to fast, with their preferential paths (Fig. 12)."""
    packing = graph.packing
    heights = np.concatenate([packing.y[list(sample.path.grains)] for sample in samples])
    # Shown are the paths with 12 % of the width around them, and at least 30 % of it to each side of the middle.
    margin, least = 0.12 * packing.width, 0.3 * packing.width
    low = max(0.0, min(float(heights.min()) - margin, packing.height / 2 - least))
    high = min(packing.height, max(float(heights.max()) + margin, packing.height / 2 + least))
    figure = new_figure(height=0.9 + len(samples) * 3.4 * (high - low) / packing.width)  # 3.4 inches wide, text beside
    panels = figure.subplots(len(samples), 1, squeeze=False)[:, 0]
    for axes, sample in zip(panels, samples, strict=True):
        draw_grains(axes, graph, sample.kinds, low=low, high=high, cement_width=1.2)
        grains = np.array(sample.path.grains)
        x, y = packing.x[grains] * MM, packing.y[grains] * MM
        axes.plot(x, y, color="white", linewidth=3.0, zorder=6, solid_joinstyle="round")
        axes.plot(x, y, color=BLACK, linewidth=1.6, zorder=7, solid_joinstyle="round")
        bare = ~np.array(sample.path.bonded, dtype=np.bool_)
        middles = [((ends[:-1] + ends[1:]) / 2)[bare] for ends in (x, y)]
        axes.plot(*middles, "o", markersize=4.2, zorder=8, **_RING)
        axes.set_anchor("W")
        features = sample.features
        velocity = f"{sample.vs:.0f} m/s" if math.isfinite(sample.vs) else "no velocity"
        lines = (
            f"seed {sample.seed}",
            velocity,
            f"$C_{{d,n}}$ = {features.path_normalized_connectivity:.2f}",
            f"path of {features.path_contacts} contacts:",
            f"{features.path_bonded_contacts} cemented, {features.path_hertz_contacts} not,",
            f"longest cemented run {features.path_longest_bonded_run:.3g}",
        )
        axes.text(1.02, 0.98, "\n".join(lines), transform=axes.transAxes, va="top", linespacing=1.5)
    letter_panels(panels)
    _draw_scale(panels[-1], 0.0, low * MM, packing.width * MM)
    line = Line2D([], [], color=BLACK, linewidth=1.8, label="preferential path")
    ring = Line2D([], [], linestyle="none", marker="o", markersize=4.5, label="uncemented contact on it", **_RING)
    figure.legend(handles=[*_legend_handles(), line, ring], loc="outside lower center", ncols=3)
    return figure


def _legend_handles() -> list[Artist]:
    """Return patches for the grains and lines for the cement."""
    return [
        Patch(facecolor=colour, label=name) if "grain" in name else Line2D([], [], color=colour, lw=2.4, label=name)
        for name, colour in COLOURS.items()
    ]


def _draw_scale(axes: Axes, left: float, low: float, width: float) -> None:
    """Draw a scale bar below a picture of this width with this lower left corner; all in mm, the unit of the data."""
    length = _round_length(width)
    y = low - 0.04 * width
    axes.plot([left, left + length], [y, y], color=BLACK, linewidth=2.0, solid_capstyle="butt", clip_on=False)
    axes.annotate(
        f"{length:g} mm",
        (left + length / 2, y),
        xytext=(0, -3),
        textcoords="offset points",
        ha="center",
        va="top",
        fontsize=8.0,
        annotation_clip=False,
    )


def _round_length(width: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is at most a quarter of a width."""
    power = 10.0 ** math.floor(math.log10(0.25 * width))
    return max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= 0.25 * width)


class _SmallGifWriter(PillowWriter):
    """Writer of frames with few colours and no dithering, which need a fifth of the space."""

    def grab_frame(self, **savefig_kwargs: Any) -> None:  # noqa: ANN401 - as matplotlib has it
        """Add a frame."""
        super().grab_frame(**savefig_kwargs)
        frames: list[Image.Image] = self._frames  # type: ignore[attr-defined]  # not in the stubs
        frame = frames[-1].convert("RGB")
        frames[-1] = frame.quantize(96, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


def movie_writer(file: Path) -> AbstractMovieWriter:
    """Writer for the ending .gif or .mp4 of a file; `OutputRefusedError` for others, or without ffmpeg."""
    if file.suffix.lower() == ".gif":
        return _SmallGifWriter(fps=15)
    if file.suffix.lower() != ".mp4":
        raise OutputRefusedError(f"{file} ends with neither .gif nor .mp4.", "Give it one of these endings.")
    if not FFMpegWriter.isAvailable():
        raise OutputRefusedError(
            f"{file} needs the program ffmpeg, which is not installed.",
            "Install it (Debian: apt-get install ffmpeg), or give a name that ends with .gif.",
        )
    return FFMpegWriter(fps=15, extra_args=["-f", "mp4"])


def write_movie(
    figure: Figure,
    frames: tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]],
    file: Path,
    writer: AbstractMovieWriter,
    watch: Callable[[int], None],
) -> None:
    """Write all frames of a figure of `draw_film` into a file; `watch` receives their number."""
    sample, signals = figure.axes[:2]
    (disks,) = (artist for artist in sample.collections if artist.get_gid() == "disks")
    (now,) = (line for line in signals.lines if line.get_gid() == "now")
    title = sample.get_title(loc="left")
    with mpl.rc_context({"savefig.bbox": None}), writer.saving(figure, str(file), dpi=90):
        for number, (time, velocity) in enumerate(zip(*frames, strict=True), start=1):
            disks.set_array(velocity)
            now.set_xdata([time * MS] * 2)
            sample.set_title(f"{title}, t = {time * MS:.3f} ms", loc="left")
            writer.grab_frame()
            figure.set_layout_engine("none")  # the layout is that of the first frame
            watch(number)


@apply_style
def draw_film(
    packing: PackingRecord,
    cemented: NDArray[np.integer[Any]],
    disks: tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]], NDArray[np.floating[Any]]],
    arrival: Arrival,
    half_widths: tuple[float, float],
    frames: tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]],
) -> Figure:
    """Draw the first frame of a wave; `write_movie` draws the others.

    ``cemented`` (m, 2) are the cemented pairs of the packing, ``disks`` x, y and radius of the computed disks, (n,) m,
    ``half_widths`` those of transmitter and receiver, m. ``frames`` are times (f,), s, and velocities of the disks
    along y (f, n), m/s.
    """
    x, y, radius = disks
    reach = min(0.6 * packing.width, packing.height / 2)  # the motion is damped beyond
    low, high = ((packing.height / 2 + side * reach) * MM for side in (-1, 1))
    width, signals_height = 4.6, 2.1  # inches
    picture_height = 0.66 * width * (high - low) / (packing.width * MM)  # the colour scale has a third of the width
    figure = new_figure(picture_height + signals_height, width)
    sample, signals = figure.subplots(2, 1, height_ratios=[picture_height, signals_height])
    style: dict[str, Any] = {"units": "xy", "edgecolor": "none", "transOffset": sample.transData}
    whole = np.column_stack([packing.x, packing.y]) * MM
    sizes = 2 * packing.radius * MM
    sample.add_collection(EllipseCollection(sizes, sizes, 0 * sizes, offsets=whole, facecolor=PALE, **style))
    sizes, places = 2 * np.array(radius, dtype=float) * MM, np.column_stack([x, y]) * MM
    moving = EllipseCollection(sizes, sizes, 0 * sizes, offsets=places, gid="disks", **style)
    largest = float(np.quantile(np.abs(frames[1]), 0.999)) or 1.0  # higher velocities belong to a few loose disks
    # Colours are linear in the square root, since the received amplitude is a tenth of the transmitted one.
    root_and_square = lambda v: np.sign(v) * np.sqrt(np.abs(v)), lambda v: v * np.abs(v)
    moving.set(cmap="RdBu_r", norm=FuncNorm(root_and_square, -largest, largest))
    moving.set_array(frames[1][0])
    sample.add_collection(moving)
    sample.add_collection(LineCollection(list(whole[cemented]), colors=BLACK, linewidths=0.5, alpha=0.5))
    draw_frame(sample, packing)
    draw_bands(sample, packing, *half_widths)
    strip_axes(sample)
    sample.set_aspect("equal")
    sample.set_xlim(-0.015 * packing.width * MM, 1.015 * packing.width * MM)  # the frame is not cut
    sample.set_ylim(low, high)
    sample.set_title(f"seed {arrival.seed} at {arrival.content:g} %")
    bar = figure.colorbar(moving, ax=sample, label="velocity along y (m/s)", shrink=0.7, extend="both")
    ticks = largest * np.array([-1.0, -0.25, 0.0, 0.25, 1.0])
    bar.set_ticks(ticks.tolist(), labels=[f"{tick:.1e}" if tick else "0" for tick in ticks])
    draw_signal_pair(signals, arrival)
    signals.axvline(frames[0][0] * MS, color=BLACK, linewidth=1.0, gid="now")
    signals.set_xlabel("time (ms)")
    figure.legend(*signals.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
