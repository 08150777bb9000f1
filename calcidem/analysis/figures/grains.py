"""Drawing grains, cement, paths and walls of a packing in one axes; lengths in millimetres."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from calcidem.analysis.contact_graph import PreferentialPath
from calcidem.analysis.figures.style import (
    BLACK,
    C_CEMENT,
    CLUSTER_GRAIN,
    GREEN,
    MM,
    P_CEMENT,
    PICTURE_MARGIN,
    PURPLE,
    SAND_GRAIN,
    VERMILION,
    strip_axes,
)
from calcidem.analysis.packing_graph import PackingGraph
from calcidem.storage.records import C_CONTACT, P_CONTACT, PackingRecord

RING: dict[str, Any] = {
    "linestyle": "none",
    "marker": "o",
    "markerfacecolor": "white",
    "markeredgecolor": PURPLE,
    "markeredgewidth": 1.3,
}
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
    """Draw the grains between two heights, m, and the cement between them, on axes that lose their ticks.

    ``kinds`` (m,) are 0 (sand), 1 (P) or 2 (C) of each contact; the width of cemented contacts is in points.
    """
    packing, pairs = sample.packing, sample.graph.pairs
    chosen = (packing.y > low) & (packing.y < high)
    in_cluster = np.zeros(packing.radius.size, dtype=np.bool_)
    if kinds is not None:
        in_cluster[pairs[kinds == C_CONTACT]] = True
    for members, colour in ((chosen & ~in_cluster, SAND_GRAIN), (chosen & in_cluster, CLUSTER_GRAIN)):
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
                facecolor=colour,
                edgecolor="white",
                linewidth=0.25,
                rasterized=True,
            )
        )
    if kinds is not None:
        inside = chosen[pairs].all(axis=1)
        for kind, colour in ((P_CONTACT, P_CEMENT), (C_CONTACT, C_CEMENT)):
            _draw_contacts(axes, packing, pairs[inside & (kinds == kind)], colour, cement_width)
    strip_axes(axes)
    axes.set_aspect("equal")
    bottom, top = max(low, 0.0) * MM, min(high, packing.height) * MM
    margin = PICTURE_MARGIN * packing.width * MM
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


def draw_path(axes: Axes, sample: PackingGraph, path: PreferentialPath, width: float = 1.6) -> None:
    """Draw a path through the centres of its grains, with a ring at each of its uncemented contacts."""
    packing, grains = sample.packing, np.array(path.grains)
    x, y = packing.x[grains] * MM, packing.y[grains] * MM
    axes.plot(x, y, color="white", linewidth=width + 1.4, zorder=6, solid_joinstyle="round")
    axes.plot(x, y, color=BLACK, linewidth=width, zorder=7, solid_joinstyle="round")
    bare_contacts = ~np.array(path.bonded, dtype=np.bool_)
    middles = [((ends[:-1] + ends[1:]) / 2)[bare_contacts] for ends in (x, y)]
    axes.plot(*middles, markersize=4.2, zorder=8, **RING)


def _draw_contacts(axes: Axes, packing: PackingRecord, pairs: NDArray[np.int64], colour: str, width: float) -> None:
    """Draw a stroke around each contact point, half as long as the distance of the two centres."""
    first, second = (np.column_stack([packing.x[ends], packing.y[ends]]) for ends in pairs.T)
    strokes = np.stack([0.75 * first + 0.25 * second, 0.25 * first + 0.75 * second], axis=1) * MM
    axes.add_collection(LineCollection(list(strokes), colors=colour, linewidths=width, rasterized=True))
