"""A wave through a sample as moving pictures: velocities of the disks, and the signals with a moving line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import FuncNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from calcidem.analysis.figures.samples import draw_bands, draw_frame
from calcidem.analysis.figures.signals import Arrival, draw_signal_pair
from calcidem.analysis.figures.style import (
    BLACK,
    MM,
    MS,
    PALE,
    apply_style,
    new_figure,
    strip_axes,
)
from calcidem.storage.errors import OutputRefusedError
from calcidem.storage.records import PackingRecord


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
