"""Scene of a shear wave: a cemented packing between transmitter and receiver.

Transmitter and receiver are bands of the side walls at mid-height. Strongly damped layers at floor and lid represent
the soil beyond (section 2.2.2 and Fig. 4 of the paper).
"""

from collections.abc import Sequence

import numpy as np

from calcidem.dem.engine.fields import require
from calcidem.dem.engine.material import Cement, Sand
from calcidem.dem.engine.scene import Bonds, Installation, Scene, Wall
from calcidem.dem.kernels.layout import Flags
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.rule import WaveRule

TRANSMITTER, RECEIVER = 1, 4  # indices of the walls of `wave_scene`


def wave_scene(packing: Packing, sand: Sand, rule: WaveRule, bonds: Bonds | None) -> Scene:
    """The packing between transmitter and receiver."""
    width, height, middle = packing.width, packing.height, packing.height / 2.0
    for name in ("transmitter_half_width", "receiver_half_width"):
        half = getattr(rule, name)
        require(half < middle, name, half, f"has to be less than half the height of the sample, {middle:.4g} m")
    require(
        rule.boundary_thickness < middle,
        "boundary_thickness",
        rule.boundary_thickness,
        f"has to be less than half the height of the sample, {middle:.4g} m",
    )
    rubbing = rule.band_friction if rule.transmitter == "wall" else 0.0
    transmitter, receiver = rule.transmitter_half_width, rule.receiver_half_width
    walls = (
        # The tangent of the left wall points up, of the right wall down; both start at mid-height.
        Wall((0.0, middle), (1.0, 0.0), span=(-np.inf, -transmitter)),
        Wall((0.0, middle), (1.0, 0.0), friction=rubbing, span=(-transmitter, transmitter)),
        Wall((0.0, middle), (1.0, 0.0), span=(transmitter, np.inf)),
        Wall((width, middle), (-1.0, 0.0), span=(receiver, np.inf)),
        Wall((width, middle), (-1.0, 0.0), friction=rule.band_friction, span=(-receiver, receiver)),
        Wall((width, middle), (-1.0, 0.0), span=(-np.inf, -receiver)),
        Wall((0.0, 0.0), (0.0, 1.0)),
        # The servo of the lid is active only while a cemented sample settles.
        Wall((0.0, height), (0.0, -1.0), servo_force=packing.report.wall_stress[-1] * width),
    )
    inside = np.abs(packing.y - middle) < middle - rule.boundary_thickness
    return Scene(
        x=packing.x,
        y=packing.y,
        radius=packing.radius,
        sand=sand,
        walls=walls,
        bonds=bonds,
        damping=np.where(inside, rule.damping, rule.boundary_damping),
    )


def lane_bonds(
    packing: Packing, cement: Cement, bonded: Sequence[Flags], lanes: int, installation: Installation
) -> Bonds | None:
    """Cement of all lanes as one set of bonds; None if no sample has any."""
    # Spare lanes repeat the first sample, so all lanes compute valid numbers.
    filled = [*bonded, *[bonded[0]] * (lanes - len(bonded))]
    bits = sum(np.asarray(flags, dtype=np.uint32) << np.uint32(lane) for lane, flags in enumerate(filled))
    cemented = np.flatnonzero(bits)
    if not len(cemented):
        return None
    return Bonds(packing.pairs[cemented], cement, np.asarray(bits)[cemented], installation)
