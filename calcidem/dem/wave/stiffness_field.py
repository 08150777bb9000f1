"""Local shear stiffness of a cemented sample, in sliding windows."""

from typing import NamedTuple

import numpy as np

from calcidem.dem.engine.fields import require
from calcidem.dem.engine.statics import ShearedTriangles, sheared_motion, sheared_triangles
from calcidem.dem.kernels.layout import Flags, Floats
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.static_speed import distances_from_walls, state_at_rest

_PIXELS = 4
"""Side of a window over its displacement."""


class StiffnessField(NamedTuple):
    """Shear modulus in square windows."""

    x: Floats
    y: Floats
    """(X,), (Y,) centres of the windows, m, a quarter of a window apart."""
    modulus: Floats
    """(Y, X) mean shear stress over mean shear strain of each window, Pa; NaN where their signs differ."""


def stiffness_field(experiment: Experiment, bonded: Flags, window: float) -> StiffnessField:
    """Return the local shear modulus in a sample that is sheared as a whole.

    `ValueError` if the sample has no stiffness, or no window fits inside its rim; `SettlingError` if new bonds change
    the forces of the sample and it does not come to rest.

    Parameters
    ----------
    experiment, bonded
        As in `calcidem.dem.wave.static_speed.static_speed`.
    window
        Side of the square windows, m; at least several grains.

    Notes
    -----
    All disks at the walls follow a simple shear and rotate freely; all others reach equilibrium, and contacts stick.
    The stress is that of Love (1927), the strain that of triangles between neighbouring centres. A triangle belongs to
    the windows that contain its centroid. A rim of a tenth of the smaller side is excluded.
    """
    packing, _ = experiment.stiffen()
    state = state_at_rest(experiment, bonded)
    held = np.minimum(*distances_from_walls(packing)) < np.asarray(packing.radius, dtype=float)
    margin = 0.1 * min(packing.width, packing.height)  # held disks stiffen this rim
    box = (margin, packing.width - margin), (margin, packing.height - margin)
    return _windowed_moduli(sheared_triangles(state, sheared_motion(state, held)), box, window)


def _windowed_moduli(
    triangles: ShearedTriangles, box: tuple[tuple[float, float], tuple[float, float]], window: float
) -> StiffnessField:
    """Shear moduli of windows of this side, m, in a box with these ends along x and y, m."""
    ends = np.asarray(box)
    pixels = np.floor((ends[:, 1] - ends[:, 0]) / window * _PIXELS + 1e-9).astype(int)  # rounding must not lose a pixel
    largest = float(np.min(ends[:, 1] - ends[:, 0]))
    require(bool(pixels.min() >= _PIXELS), "window", window, f"give at most {largest:.3g} m, the size inside the rim")
    pixel = window / _PIXELS
    edges = [middle + pixel * (np.arange(n + 1) - n / 2) for middle, n in zip(ends.mean(axis=1), pixels, strict=True)]
    sums = []
    for values in (triangles.stress, triangles.strain):
        found = np.histogram2d(triangles.middle[:, 0], triangles.middle[:, 1], bins=edges, weights=values)[0]
        for axis in (0, 1):  # sums over the pixels of each window
            found = np.lib.stride_tricks.sliding_window_view(found, _PIXELS, axis=axis).sum(axis=-1)
        sums.append(found.T)
    stress, strain = sums
    x, y = (0.5 * (edge[_PIXELS:] + edge[:-_PIXELS]) for edge in edges)
    modulus = np.full(stress.shape, np.nan)
    np.divide(stress, strain, out=modulus, where=stress * strain > 0.0)
    return StiffnessField(x, y, modulus)
