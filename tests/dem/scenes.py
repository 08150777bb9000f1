"""Small scenes that several tests of the physics use."""

import numpy as np

from calcidem.dem.engine.scene import Bonds, Cement, Preload, Sand, Scene, Wall
from calcidem.dem.kernels.layout import Features, Floats, Integers
from calcidem.dem.sample.packing import Packing, PackingReport

RADIUS = 1.0e-3
SPACING = 2.0 * RADIUS * (1.0 - 1e-3)
"""Of chains and lattices whose disks overlap, so that the contacts have a stiffness."""

SOFT = Sand(shear_modulus=1.0e9)  # a soft material makes overlaps, and so what a bug would change, easy to see

# Each combination of features is compiled once, some seconds each, so tests share a few: HERTZ, BONDED
# and GROUPED are those that `choose_features` gives to such scenes, SERVO is that of small packings.
HERTZ = Features(search=True, midpoint=True)
SERVO = Features(search=True, servo=True, loads=False)
ACCOUNT = Features(bonds=True, breakage=True, search=True, account=True)
BONDED = Features(bonds=True, breakage=True, search=True, midpoint=True)
GROUPED = Features(bonds=True, linear_group=True, breakage=True, search=True, midpoint=True)
LINEAR = Features(linear=True, bonds=True, linear_group=True, slip=False, rescaling=False)

SOFT_CEMENT = Cement(bond_modulus=2.0e8, linear_modulus=1.0e8, bond_stiffness_ratio=2.0, linear_stiffness_ratio=1.5)


def pair_scene(gap: float = 0.0, second_radius: float = RADIUS, **options: object) -> Scene:
    """Two disks side by side along x, ``gap`` apart (negative: overlapping)."""
    radius = np.array([RADIUS, second_radius])
    return Scene(x=np.array([0.0, radius.sum() + gap]), y=np.zeros(2), radius=radius, **options)  # type: ignore[arg-type]


def contact_stiffness() -> tuple[float, float]:
    """Normal and shear stiffness (N/m) of contacts of `SOFT` disks `SPACING` apart."""
    radius = np.array([RADIUS])
    normal = 1.5 * float(SOFT.hertz_coefficient(radius, radius)[0]) * np.sqrt(2.0 * RADIUS - SPACING)
    return normal, SOFT.shear_ratio * normal


def hexagonal(columns: int, rows: int, spacing: float) -> tuple[Floats, Floats]:
    """Centres of a hexagonal lattice, rows along x."""
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    x = (column + 0.5 * (row % 2)) * spacing
    return x.ravel(), (row * spacing * np.sqrt(0.75)).ravel()


def jumble(seed: int, count: int = 12, *, walls: bool = True, share_bonded: float = 0.0, **options: object) -> Scene:
    """Unequal disks in a disordered heap, touching with overlaps of some thousandths of a radius.

    The heap is not in equilibrium: released, it flies apart, rubs and rolls. Bonds differ between the lanes, except
    where all pairs are bonded.
    """
    generator = np.random.default_rng(seed)
    columns = int(np.ceil(np.sqrt(count)))
    x, y = hexagonal(columns, columns, 1.995 * RADIUS)
    chosen = np.arange(count)
    jitter = generator.uniform(-4e-3, 4e-3, (2, count)) * RADIUS
    x, y = x[chosen] + jitter[0], y[chosen] + jitter[1]
    radius = RADIUS * generator.uniform(0.996, 1.004, count)
    bonds = None
    if share_bonded > 0.0:
        near = np.array(
            [(i, j) for i in range(count) for j in range(i) if np.hypot(x[i] - x[j], y[i] - y[j]) < 2.02 * RADIUS]
        )
        bonded = generator.random(len(near)) < share_bonded
        bonded[0] = True
        cement = options.pop("cement", SOFT_CEMENT)
        lanes = None if share_bonded == 1.0 else generator.integers(1, 2**16, len(near), dtype=np.uint32)[bonded]
        installation = options.pop("installation", "preserve")
        bonds = Bonds(near[bonded], cement, lanes, installation)  # type: ignore[arg-type]
    box = ()
    if walls:
        box = (
            Wall((x.min() - 0.999 * RADIUS, 0.0), (1.0, 0.0), friction=0.3, velocity=(0.02, 0.05)),
            Wall((0.0, y.min() - 0.999 * RADIUS), (0.0, 1.0), friction=0.0),
            Wall((x.max() + 1.0 * RADIUS, 0.0), (-0.8, 0.6), friction=0.9, velocity=(-0.01, 0.0)),
        )
    settings = {"sand": SOFT, "walls": box, "bonds": bonds, **options}
    return Scene(x=x, y=y, radius=radius, **settings)  # type: ignore[arg-type]


def throw(scene: Scene, seed: int, speed: float = 0.05) -> tuple[Floats, Floats]:
    """Random velocities (N, 2) and spins (N,) for a scene."""
    generator = np.random.default_rng([seed, 1])
    velocity = speed * generator.standard_normal((scene.count, 2))
    return velocity, speed / RADIUS * generator.standard_normal(scene.count)


def bare_packing(
    x: Floats, y: Floats, radius: Floats, pairs: Integers, box: tuple[float, float], overlap: float = 1e-6
) -> Packing:
    """A packing with a report that nobody computed; its contacts have no shear force."""
    report = PackingReport(
        porosity=0.2,
        coordination_number=3.0,
        coordination_number_without_rattlers=3.0,
        rattlers=0,
        wall_stress=(5e3, 5e3, 5e3, 5e3),
        mean_overlap=overlap,
        largest_overlap=overlap,
        unbalanced_ratio=0.0,
        steps=0,
        seconds=0.0,
    )
    return Packing(x, y, radius, *box, Preload(pairs, np.zeros(len(pairs))), report)
