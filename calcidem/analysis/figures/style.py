"""Common style of all figures: colours, sizes, units, and output to files."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from io import BytesIO
from pathlib import Path
from string import ascii_lowercase
from typing import Any, Generic, ParamSpec, TypeVar, cast

import matplotlib.style
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from PIL import Image

P = ParamSpec("P")
T = TypeVar("T")

# Okabe and Ito (2008), distinguishable with every kind of colour vision.
BLACK = "#1a1a1a"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
GREY = "#8a8f94"
PALE = "#d9dde1"

MM = MS = 1e3
KHZ = 1e-3
"""Millimetres in a metre, milliseconds in a second, kilohertz in a hertz."""

SEQUENCE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
CONTENT_MAP = "viridis"

FIGURE_WIDTH = 6.2
"""Width of a figure in inches: a column of the report, readable on a phone."""

CONTENT_LABEL = "calcite content (% of sand mass)"
VS_LABEL = "shear-wave velocity $V_s$ (m/s)"

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#50565b",
    "axes.labelcolor": BLACK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.prop_cycle": cycler(color=SEQUENCE),
    "grid.color": "#e6e8ea",
    "grid.linewidth": 0.6,
    "xtick.color": "#50565b",
    "ytick.color": "#50565b",
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "mathtext.default": "it",
    "figure.dpi": 150.0,
    "figure.autolayout": False,
    "figure.constrained_layout.use": False,
    "savefig.dpi": 150.0,
    # The same data give the same file, byte for byte.
    "svg.hashsalt": "calcidem",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
}


@dataclass(frozen=True, slots=True)
class FigureEntry(Generic[T]):
    """Figure that is drawn from a campaign, or from a study of settings, and its texts."""

    name: str
    """File name without ending."""
    title: str
    """Title in a few words."""
    caption: str
    """Caption in sentences."""
    draw: Callable[[T], Figure]
    """Draws it from a `CampaignAnalysis`, or from the result of a study; `UnavailableError` if data are missing."""
    pictorial: bool = False
    """Whether it shows thousands of grains, which are better drawn as pixels than as vectors."""
    study: str = ""
    """Study that it shows, "frequency" or "damping"; empty for a figure of the campaign itself."""


class _StyledFigure(Figure):
    """Figure that every canvas draws in this style.

    matplotlib creates texts of ticks only when a canvas draws. With the settings of a user's matplotlibrc, such as
    ``text.usetex`` without LaTeX, a figure would fail there.
    """

    def draw(self, renderer: RendererBase) -> None:
        """Draw all artists."""
        with matplotlib.style.context(_STYLE, after_reset=True):
            super().draw(renderer)


def apply_style(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Make a function draw in this style, independent of the caller's settings of matplotlib."""

    @wraps(draw)
    def inner(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with matplotlib.style.context(_STYLE, after_reset=True):
            return draw(*args, **kwargs).figure  # the whole figure if only a part was drawn

    return inner


_CALLERS_AXES: ContextVar[Axes | None] = ContextVar("place", default=None)
"""Axes of the caller in which the next figure is drawn."""


@contextmanager
def drawn_in(place: Axes | None) -> Iterator[None]:
    """Draw the figure made in this context in axes of the caller; None for a new figure.

    A figure of one panel is added to these axes. A figure of several panels replaces them, so they have to be part of a
    grid, as made by `plt.subplots`.
    """
    if place is not None and place.figure is None:
        raise ValueError("ax was removed from its figure: make new axes with plt.subplots.")
    token = _CALLERS_AXES.set(place)
    try:
        yield
    finally:
        _CALLERS_AXES.reset(token)


def new_figure(height: float, width: float = FIGURE_WIDTH) -> Figure:
    """Return an empty figure of a size in inches, without a window, or a part of the caller's figure."""
    if (place := _CALLERS_AXES.get()) is None:
        return _StyledFigure(figsize=(width, height), layout="constrained")
    if (cell := place.get_subplotspec()) is None:
        raise ValueError("ax is not of a grid, and this figure has several panels: make it with plt.subplots.")
    owner = place.figure
    if owner.figure.get_layout_engine() is None:  # without one, a part with several panels overlaps
        owner.figure.set_layout_engine("constrained")
    place.remove()
    return cast("Figure", owner.add_subfigure(cell))  # a part of a figure accepts the same drawing calls


def new_panel(height: float, width: float = FIGURE_WIDTH) -> tuple[Figure, Axes, bool]:
    """Return a whole figure with its only panel, and whether they are the caller's."""
    if (place := _CALLERS_AXES.get()) is None:
        figure = new_figure(height, width)
        return figure, figure.subplots(), False
    return place.figure.figure, place, True  # the figure of a part, or the figure itself


def pick_evenly(items: Sequence[T], count: int) -> list[T]:
    """Return at most `count` items from the first to the last, evenly spaced in their order."""
    places = np.unique(np.linspace(0, len(items) - 1, count).round().astype(int))
    return [items[place] for place in places]


def letter_panels(panels: Iterable[Axes], **look: Any) -> None:  # noqa: ANN401 - of a text of matplotlib
    """Put (a), (b), ... before the left titles of several panels; `look` is passed to `Axes.set_title`."""
    lettered = list(panels)
    for place, axes in enumerate(lettered if len(lettered) > 1 else ()):
        rounds, letter = divmod(place, len(ascii_lowercase))
        name = (ascii_lowercase[rounds - 1] if rounds else "") + ascii_lowercase[letter]
        axes.set_title(f"({name}) {axes.get_title(loc='left')}".rstrip(), loc="left", **look)


def strip_axes(axes: Axes) -> None:
    """Remove grid, ticks and frame from axes that show a picture."""
    axes.grid(visible=False)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def render(figure: Figure, file_format: str, colours: int | None = None) -> bytes:
    """Return the bytes of a figure as "png" (150 dpi), "svg" or "pdf"; equal figures give equal bytes."""
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(file_format, {})
    buffer = BytesIO()
    with matplotlib.style.context(_STYLE, after_reset=True):
        if (layout := figure.get_layout_engine()) is not None:
            layout.execute(figure)
            figure.set_layout_engine(None)  # with a layout engine `savefig` draws and lays out twice
        options: dict[str, Any] = {} if colours is None else {"pil_kwargs": {"compress_level": 0}}  # compressed below
        figure.savefig(buffer, format=file_format, metadata=metadata, **options)
    return buffer.getvalue() if colours is None else reduce_colours(buffer.getvalue(), colours)


def reduce_colours(png: bytes, colours: int = 256) -> bytes:
    """Return a PNG with a palette, since pictures of grains are large but have few colours."""
    small = BytesIO()
    with Image.open(BytesIO(png)) as picture:
        # Octree keeps rare colours such as those of thin rings; median cut loses them.
        palette = picture.convert("RGB").quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        palette.save(small, "png", optimize=True)
    return small.getvalue()


def save(figure: Figure, folder: Path, name: str, formats: tuple[str, ...] = ("png", "svg", "pdf")) -> list[Path]:
    """Write a figure to `folder`/`name`.* in several formats and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.{file_format}" for file_format in formats]
    for file, file_format in zip(files, formats, strict=True):
        file.write_bytes(render(figure, file_format))
    return files
