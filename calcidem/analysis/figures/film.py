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
    CORRELATION_MAP,
    MM,
    MS,
    PALE,
    PICTURE_MARGIN,
    apply_style,
    new_figure,
    strip_axes,
)
from calcidem.storage.errors import OutputRefusedError
from calcidem.storage.records import PackingRecord

_FILM_WIDTH = 4.6
_SIGNALS_HEIGHT = 2.1
"""Inches."""
_PICTURE_SHARE = 0.66
"""Share of the figure's width; the colour scale has the rest."""
_SHOWN = 0.6
"""Displayed height above and below the middle, over the width of the box; beyond it the motion is damped."""
_GIF_PALETTE = 96
_COLOURED = 0.999
"""Quantile of all velocities with the last colour; higher ones belong to a few loose disks."""
_DOTS = 90
_MOVIE_RATE = 15


class _SmallGifWriter(PillowWriter):
    """Writer of frames with few colours and no dithering, which need a fifth of the space."""

    def grab_frame(self, **savefig_kwargs: Any) -> None:  # noqa: ANN401 - as matplotlib has it
        """Add a frame."""
        super().grab_frame(**savefig_kwargs)
        frames: list[Image.Image] = self._frames  # type: ignore[attr-defined]  # not in the stubs
        frame = frames[-1].convert("RGB")
        frames[-1] = frame.quantize(_GIF_PALETTE, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


def movie_writer(file: Path) -> AbstractMovieWriter:
    """Writer for the ending .gif or .mp4 of a file; `OutputRefusedError` for others, or without ffmpeg."""
    if file.suffix.lower() == ".gif":
        return _SmallGifWriter(fps=_MOVIE_RATE)
    if file.suffix.lower() != ".mp4":
        raise OutputRefusedError(f"{file} ends with neither .gif nor .mp4.", "Give it one of these endings.")
    if not FFMpegWriter.isAvailable():
        raise OutputRefusedError(
            f"{file} needs the program ffmpeg, which is not installed.",
            "Install it (Debian: apt-get install ffmpeg), or give a name that ends with .gif.",
        )
    return FFMpegWriter(fps=_MOVIE_RATE, extra_args=["-f", "mp4"])


def write_movie(
    figure: Figure,
    frames: tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]],
    file: Path,
    writer: AbstractMovieWriter,
    watch: Callable[[int], None],
) -> None:
    """Write all frames of a figure of `draw_film` into a file; `watch` receives their number."""
    show = _frame_shower(figure, *frames)
    with mpl.rc_context({"savefig.bbox": None}), writer.saving(figure, str(file), _DOTS):
        for frame in range(len(frames[0])):
            show(frame)
            writer.grab_frame()
            figure.set_layout_engine("none")  # the layout is that of the first frame
            watch(frame + 1)


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
    reach = min(_SHOWN * packing.width, packing.height / 2)
    low, high = ((packing.height / 2 + side * reach) * MM for side in (-1, 1))
    picture = _PICTURE_SHARE * _FILM_WIDTH * (high - low) / (packing.width * MM)
    figure = new_figure(picture + _SIGNALS_HEIGHT, _FILM_WIDTH)
    sample, signals = figure.subplots(2, 1, height_ratios=[picture, _SIGNALS_HEIGHT])
    style: dict[str, Any] = {"units": "xy", "edgecolor": "none", "transOffset": sample.transData}
    whole = np.column_stack([packing.x, packing.y]) * MM
    sizes = 2 * packing.radius * MM
    sample.add_collection(EllipseCollection(sizes, sizes, 0 * sizes, offsets=whole, facecolor=PALE, **style))
    sizes, places = 2 * np.array(radius, dtype=float) * MM, np.column_stack([x, y]) * MM
    moving = EllipseCollection(sizes, sizes, 0 * sizes, offsets=places, gid="disks", **style)
    largest = float(np.quantile(np.abs(frames[1]), _COLOURED)) or 1.0
    # Colours are linear in the square root, since the received amplitude is a tenth of the transmitted one.
    moving.set(cmap=CORRELATION_MAP, norm=FuncNorm((_signed_root, _signed_square), -largest, largest))
    moving.set_array(frames[1][0])
    sample.add_collection(moving)
    sample.add_collection(LineCollection(list(whole[cemented]), colors=BLACK, linewidths=0.5, alpha=0.5))
    draw_frame(sample, packing)
    draw_bands(sample, packing, *half_widths)
    strip_axes(sample)
    sample.set_aspect("equal")
    sample.set_xlim(-PICTURE_MARGIN * packing.width * MM, (1.0 + PICTURE_MARGIN) * packing.width * MM)
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


def _frame_shower(
    figure: Figure, times: NDArray[np.floating[Any]], velocity: NDArray[np.floating[Any]]
) -> Callable[[int], None]:
    """Return the function that shows one frame in a figure of `draw_film`; arguments as its `frames`."""
    (disks,) = (artist for artist in figure.axes[0].collections if artist.get_gid() == "disks")
    (now,) = (line for line in figure.axes[1].lines if line.get_gid() == "now")
    title = figure.axes[0].get_title(loc="left")

    def show(frame: int) -> None:
        disks.set_array(velocity[frame])
        now.set_xdata([times[frame] * MS] * 2)
        figure.axes[0].set_title(f"{title}, t = {times[frame] * MS:.3f} ms", loc="left")

    return show


def _signed_root(value: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    return np.asarray(np.sign(value) * np.sqrt(np.abs(value)))


def _signed_square(value: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    return np.asarray(value * np.abs(value))
