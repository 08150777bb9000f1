"""Pictures of samples: signals, dispersion, cement, transmission of the wave, preferential paths; moving pictures."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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

from calcidem.analysis.campaign_analysis import CampaignAnalysis, MeasuredSample, UnavailableError
from calcidem.analysis.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    KHZ,
    MM,
    MS,
    ORANGE,
    PALE,
    PURPLE,
    VERMILION,
    apply_style,
    letter_panels,
    new_figure,
    new_panel,
    pick_evenly,
    strip_axes,
)
from calcidem.analysis.packing_graph import PackingGraph
from calcidem.analysis.velocity import ContentDispersion
from calcidem.storage.errors import OutputRefusedError, UnknownCellError
from calcidem.storage.records import C_CONTACT, P_CONTACT, CellResult, PackingRecord

COLOURS = {"sand grain": "#d3e0ea", "grain in a C cluster": "#f6c667", "P contact": BLUE, "C contact": "#a63603"}
"""Colour of each part of a sample, by its name in the legend; grains and cement differ in brightness."""


METHOD_STYLES = {
    "peak": ("peak to peak", VERMILION, "v"),
    "first_arrival": ("first arrival", GREEN, "o"),
    "cross_correlation": ("cross-correlation", ORANGE, "s"),
}
"""Label, colour and marker of each method of reading; names as in the stored quantities vs_*."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """Signals of one sample and their arrivals."""

    seed: int
    content: float
    """Identity of the sample; content in percent."""
    time: NDArray[np.float64]
    """s, shape (t,)."""
    transmitted: NDArray[np.float64]
    received: NDArray[np.float64]
    """The two signals at these times, shape (t,), m/s."""
    distance: float
    """Distance between transmitter and receiver, m."""
    velocities: Mapping[str, float]
    """Velocity in m/s for the methods of `METHOD_STYLES` that have one."""

    @property
    def transmitted_peak(self) -> float:
        """Time of the transmitted peak, s."""
        return float(self.time[np.argmax(self.transmitted)])

    @property
    def transmitted_onset(self) -> float:
        """Time at which the transmitted pulse rises to a tenth of its peak, the level of the first arrival, s."""
        peak = int(np.argmax(self.transmitted))
        level = 0.1 * self.transmitted[peak]
        below = int(np.flatnonzero(self.transmitted[: peak + 1] < level)[-1])
        around = slice(below, below + 2)
        return float(np.interp(level, self.transmitted[around], self.time[around]))

    def arrival_time(self, method: str) -> float:
        """Return the arrival time by a method, s.

        Times count from the transmitted peak, those of the first arrival from the transmitted onset.
        """
        began = self.transmitted_onset if method == "first_arrival" else self.transmitted_peak
        return began + self.distance / self.velocities[method]


def load_arrival(analysis: CampaignAnalysis, seed: int, content: float) -> Arrival:
    """Return the signals of a sample and their arrivals; `UnavailableError` if it or its section is not stored."""
    try:
        return read_arrival(analysis, analysis.cell(seed, content))
    except UnknownCellError as error:
        raise UnavailableError(str(error)) from error


def read_arrival(analysis: CampaignAnalysis, cell: CellResult) -> Arrival:
    """Return the signals of a cell and their arrivals; `UnavailableError` if no section is stored."""
    section = cell.section
    if section is None:
        raise UnavailableError(f"no section is stored for seed {cell.key.seed} at {cell.key.content:g} %")
    velocities = {name: getattr(cell, f"vs_{name}") for name in METHOD_STYLES}
    return Arrival(
        seed=cell.key.seed,
        content=cell.key.content,
        time=section.time,
        transmitted=section.transmitted,
        received=section.received,
        # A cell whose path is the whole width has no distance.
        distance=cell.distance or analysis.store.packing(cell.packing_index).width,
        velocities={name: value for name, value in velocities.items() if value is not None},
    )


def draw_signal_pair(axes: Axes, arrival: Arrival) -> None:
    """Draw both signals of a sample, each over its own peak, and mark the arrivals."""
    time = arrival.time * MS
    axes.axhline(0, color=GREY, linewidth=0.6)
    pulse = arrival.transmitted / np.max(arrival.transmitted)
    axes.fill_between(time, pulse, color=GREY, alpha=0.35, linewidth=0, label="transmitted")
    seen = np.searchsorted(arrival.time, arrival.arrival_time("peak")) if "peak" in arrival.velocities else time.size
    largest = np.abs(arrival.received[: seen + 1]).max()
    axes.plot(time, arrival.received / largest, color=BLUE, label="received")
    for method, (label, colour, marker) in METHOD_STYLES.items():
        if method not in arrival.velocities:
            continue
        moment = arrival.arrival_time(method)
        # A peak is marked from above, so that the other marks do not hide it.
        level = np.interp(moment, arrival.time, arrival.received / largest) + (0.14 if method == "peak" else 0.0)
        look: dict[str, Any] = {"markersize": 6, "color": colour, "markeredgecolor": "white", "markeredgewidth": 0.7}
        axes.plot(moment * MS, level, marker, zorder=5, label=label, **look)
    axes.set_xlim(0, time[-1])
    axes.set_ylim(min(-0.6, 1.1 * float(arrival.received.min()) / largest), 1.35)
    axes.set_ylabel("signal / its peak")


@apply_style
def draw_signals(arrivals: Sequence[Arrival]) -> Figure:
    """Draw the signals of samples below one another, from the least to the most cemented, with their arrivals."""
    figure = new_figure(height=0.8 + 1.45 * len(arrivals))
    panels = figure.subplots(len(arrivals), 1, squeeze=False)[:, 0]
    handles: dict[str, Artist] = {}
    for axes, arrival in zip(panels, arrivals, strict=True):
        draw_signal_pair(axes, arrival)
        axes.set_title(f"{arrival.content:g} %, seed {arrival.seed}")
        for line, (method, velocity) in enumerate(arrival.velocities.items()):
            text = f"{METHOD_STYLES[method][0]}:\n{velocity:.0f} m/s"
            axes.text(1.02, 1 - 0.36 * line, text, va="top", fontsize=8, transform=axes.transAxes)
        found, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, found, strict=True))
    letter_panels(panels)
    panels[-1].set_xlabel("time (ms)")
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=len(handles))
    return figure


@apply_style
def draw_dispersion(contents: Sequence[ContentDispersion]) -> Figure:
    """Draw power over frequency and phase velocity, and the phase velocity with its error, of at most six contents."""
    contents = pick_evenly(contents, 6)
    lines = -(-len(contents) // 2)
    figure = new_figure(height=0.7 + 2.1 * lines)
    panels = figure.subplots(lines, 2, squeeze=False).ravel()
    for axes, shown in zip(panels, contents, strict=False):
        _draw_content_dispersion(axes, shown)
    label = "power of plane waves (1: all stations in phase)"
    figure.colorbar(panels[0].collections[0], ax=panels.tolist(), label=label, aspect=40, pad=0.01)
    letter_panels(panels[: len(contents)])
    for axes in panels[len(contents) :]:
        axes.set_axis_off()
    figure.supxlabel("frequency (kHz)", fontsize=9)
    figure.supylabel("phase velocity (m/s)", fontsize=9)
    labelled = max((axes.get_legend_handles_labels() for axes in panels), key=lambda found: len(found[1]))
    figure.legend(*labelled, loc="outside upper center", ncols=2)
    return figure


def _draw_content_dispersion(axes: Axes, shown: ContentDispersion) -> None:
    """Draw the spectrum of one content and its dispersion."""
    found = shown.found
    # A ridge of stations in random phases has less power. As of a cell, a velocity has an error of at most a quarter.
    known = (found.power.max(axis=1) > 0.3) & ~(found.standard_error > 0.25 * found.phase_velocity)
    ridge = np.where(known, found.phase_velocity, np.nan)
    axes.grid(visible=False)
    axes.pcolormesh(
        found.frequency * KHZ, found.velocity, found.power.T, cmap="Blues", vmin=0.0, vmax=1.0, rasterized=True
    )
    axes.errorbar(
        found.frequency * KHZ,
        ridge,
        yerr=found.standard_error,
        fmt="o-",
        color=BLACK,
        markersize=2.5,
        linewidth=0.8,
        label="phase velocity and its standard error",
    )
    axes.axhline(shown.vs, color=VERMILION, linewidth=0.9, linestyle=":", label="median Vs")
    if np.isfinite(shown.static):
        axes.axhline(shown.static, color=GREEN, linewidth=0.9, linestyle="--", label="static speed (median)")
    ends = (found.phase_velocity + np.outer([-1.0, 1.0], found.standard_error))[:, known]
    reached = [*ends[np.isfinite(ends)], shown.vs]
    axes.set_ylim(min(0.45 * shown.vs, 0.9 * min(reached)), max(2.2 * shown.vs, 1.1 * max(reached)))
    axes.set_xlim(0.0, (found.frequency[-1] + 0.5 * (found.frequency[-1] - found.frequency[-2])) * KHZ)
    axes.set_title(f"{shown.content:g} % ({found.samples} sample{'s' * (found.samples != 1)})")


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
        axes.spines[:].set(visible=True, linewidth=1.1, edgecolor=BLACK)
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
            f"seed {sample.seed} at {sample.content:g} %",
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
    """Draw a scale bar below a picture of this width with this lower left corner; all in mm, the unit of the data.

    Its length is the largest of 1, 2 and 5 times a power of ten that is at most a quarter of the width.
    """
    power = 10.0 ** math.floor(math.log10(0.25 * width))
    length = max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= 0.25 * width)
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
