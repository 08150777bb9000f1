"""Local stiffness of cemented samples as a random field: mean, variance and correlation length.

    python examples/random_field.py CAMPAIGN.db --seeds 4 --content 0.66 --content 5 --window 0.012

Each sample is sheared as a whole: the disks at its rim follow a simple shear, all others find their places. The shear
modulus of a square window is its mean shear stress (Love 1927) over its mean shear strain (of triangles between
neighbouring centres). A rim of a tenth of the smaller side is left out, since held disks stiffen it. The scale of
fluctuation is twice the area below the autocorrelation up to its first zero (Vanmarcke 1983, Random Fields, chapter 5).
Values without any correlation have the window as their scale, so a model needs the window as well.
"""

import argparse
from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.spatial import Delaunay

import calcidem
from calcidem import dem

STEPS = 4000  # after which the modulus of a sample of 4,700 disks changes by 1 %
RATE = 1.0e-3  # 1/s; the strain after all steps is below 1e-6, so that no contact slips
PIXELS = 4  # side of a window over the distance of windows


def windows(points: np.ndarray, weights: np.ndarray, edges: list[np.ndarray]) -> np.ndarray:
    """Sums of weights (K,) at points (K, 2) in overlapping windows, (Y, X)."""
    sums = np.histogram2d(*points.T, bins=edges, weights=weights)[0].T
    for axis in (0, 1):
        sums = np.lib.stride_tricks.sliding_window_view(sums, PIXELS, axis=axis).sum(axis=-1)
    return sums


def moments(forces: dem.ContactForces, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place (C, 2) of each contact, and its part of the shear stress times area, N, tension positive."""
    first, second = centres[forces.pairs.T]
    branch = second - first
    normal = branch / np.hypot(*branch.T)[:, None]
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    force = forces.normal[:, None] * normal + forces.shear[:, None] * tangent
    return 0.5 * (first + second), -0.5 * (branch[:, 0] * force[:, 1] + branch[:, 1] * force[:, 0])


def modulus(campaign: calcidem.Campaign, seed: int, content: float, window: float) -> xr.DataArray:
    """Shear modulus (y, x) of a sample in windows of this side (m), Pa; NaN where stress and strain differ in sign."""
    sample = campaign.sample(seed=seed, content=content)
    packing, centres = sample.packing, np.column_stack([sample.packing.x, sample.packing.y])
    size = np.array([packing.width, packing.height])
    held = np.minimum(centres, size - centres).min(axis=1) < packing.radius
    scene = replace(sample.scene, walls=(), held=held, damping=0.7)
    velocity = np.column_stack([np.zeros(scene.count), RATE * centres[:, 0]])
    spin = np.full(scene.count, 0.5 * RATE)
    begin = dem.start(scene, velocity=velocity, spin=spin, preload=packing.preload)
    end = dem.advance(begin, STEPS)
    pixel, inner = window / PIXELS, size - 0.2 * size.min()
    counts = np.floor(inner / pixel + 1e-9).astype(int)
    edges = [0.5 * side + pixel * (np.arange(n + 1) - n / 2) for side, n in zip(size, counts, strict=True)]
    stress = windows(*moments(dem.contact_forces(end), centres), edges)
    stress -= windows(*moments(dem.contact_forces(begin), centres), edges)
    corners = Delaunay(centres).simplices
    places, moved = centres[corners], (end.position() - centres)[corners]
    sides = np.roll(places, 1, axis=1) - np.roll(places, -1, axis=1)  # opposite to each corner
    area = 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    shear = 0.5 * (moved[:, :, 0] * sides[:, :, 0] - moved[:, :, 1] * sides[:, :, 1]).sum(axis=1)
    strain, whole = (windows(places.mean(axis=1), v * np.sign(area), edges) for v in (shear, area))
    found = np.full(stress.shape, np.nan)
    np.divide(stress * whole, strain * window**2, out=found, where=stress * strain > 0.0)
    x, y = (0.5 * (edge[PIXELS:] + edge[:-PIXELS]) for edge in edges)
    return xr.DataArray(found, {"y": y, "x": x}, ("y", "x"), attrs={"units": "Pa", "window": window})


def scale_of_fluctuation(logs: xr.DataArray, axis: str) -> float:
    """Scale along x or y, m, of fields (seed, y, x), NaN left out; NaN for equal values."""
    # The mean of all samples is subtracted; that of each would remove wavelengths above its size.
    centred = np.moveaxis((logs - logs.mean()).to_numpy(), logs.dims.index(axis), -1)
    known, values, count = np.isfinite(centred), np.nan_to_num(centred), centred.shape[-1]
    sums = [(values[..., lag:] * values[..., : count - lag]).sum() for lag in range(count)]
    pairs = [(known[..., lag:] & known[..., : count - lag]).sum() for lag in range(count)]
    with np.errstate(invalid="ignore"):
        correlation = np.divide(sums, pairs) / (sums[0] / pairs[0])
    end = int(np.argmin(correlation > 0.0)) or count  # of the positive part
    if not sums[0] > 0.0:
        return np.nan
    area = correlation[:end].sum() - 0.5 * (correlation[0] + correlation[end - 1])
    if end < count and np.isfinite(correlation[end]):  # a straight line leads to the zero
        area += 0.5 * correlation[end - 1] ** 2 / (correlation[end - 1] - correlation[end])
    return float(2.0 * area * (logs[axis][1] - logs[axis][0]))


def describe(logs: xr.DataArray) -> dict[str, float]:
    """Log-normal random field of ln G (seed, y, x), G in Pa; lengths in m."""
    variance = float(logs.var())
    return {
        "geometric_mean": float(np.exp(logs.mean())),
        "log_deviation": variance**0.5,
        "between_samples": float(logs.mean(("y", "x")).var()) / variance if variance > 0.0 else np.nan,
        "scale_x": scale_of_fluctuation(logs, "x"),
        "scale_y": scale_of_fluctuation(logs, "y"),
        "unknown": float(logs.isnull().mean()),
    }


def main() -> None:
    """Print a row for each content."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("database")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--content", type=float, action="append", required=True, help="percent; may be repeated")
    parser.add_argument("--window", type=float, default=0.012, help="side of a window, m; several grains")
    options = parser.parse_args()
    print("content %, geometric mean MPa, sd of ln G, part between samples, scale along x mm, along y mm, unknown")
    with calcidem.open_campaign(options.database) as campaign:
        for content in options.content:
            seeds = range(1, options.seeds + 1)
            fields = [np.log(modulus(campaign, seed, content, options.window)) for seed in seeds]
            found = describe(xr.concat(fields, dim="seed"))
            units = (1e-6, 1.0, 1.0, 1e3, 1e3, 1.0)
            numbers = (f"{unit * value:.4g}" for unit, value in zip(units, found.values(), strict=True))
            print(f"{content:g}", *numbers, sep=", ")


if __name__ == "__main__":
    main()
