"""Prints a hash of everything whose bits must not depend on the processor: a line ``hash name`` for each.

    python program.py small|paper [--packing FILE] [--laws linear finite] [--lanes 1 8] [--contents 0 2.55]

``small`` is a box of 280 disks, ``paper`` the 4,663 disks of the preset `paper`. With ``--packing`` the
waves run through a packing of that file, which is written if it is not there.
"""

import argparse
import hashlib
from collections.abc import Iterator
from dataclasses import astuple, replace
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from calcidem.app.campaign.packing import packing_from_bytes, packing_to_bytes
from calcidem.app.config import presets
from calcidem.app.config.reader import load_configuration
from calcidem.dem.engine.scene import Law, Sand
from calcidem.dem.sample.cement import CementRule, RandomPurpose, random_generator
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import Packing, PackingRule
from calcidem.dem.wave.experiment import Experiment, WaveRule
from calcidem.dem.wave.measurement import Measurement, measure
from calcidem.dem.wave.reading import PickRule
from calcidem.ends import CellStatus

SEEDS = (1, 2, 3)
SMALL = PackingRule(width=0.03, height=0.06, unbalanced_force_ratio=1e-5)
SMALL_WAVE = WaveRule(
    transmitter_half_width=0.01, receiver_half_width=0.012, boundary_thickness=0.012, listening_depth=0.006
)
PAPER = load_configuration(Path(presets.__file__).parent / "paper.toml")


def digest(*values: npt.ArrayLike | None) -> str:
    """Hash of the bits of arrays and numbers."""
    found = hashlib.sha256()
    for value in values:
        array = np.ascontiguousarray(np.nan if value is None else value)
        found.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())
    return found.hexdigest()[:16]


def packed(scene: str) -> Packing:
    """Packing of a scene, made anew."""
    if scene == "small":
        return make_packing(SMALL, Sand(), np.random.default_rng(1))
    generator = random_generator(PAPER.campaign.root_seed, PAPER.packing_draw.seed, RandomPurpose.DISKS)
    return make_packing(PAPER.packing, PAPER.sand, generator)


def experiment_on(scene: str, packing: Packing, law: Law) -> Experiment:
    """Experiment of a scene."""
    if scene == "small":
        wave = replace(SMALL_WAVE, amplitude=1e-4 if law == "linear" else 1e-3)
        pick = PickRule(largest_error=1.0)  # there is no longer way in so small a box
        experiment = Experiment(
            packing, cement_rule=CementRule(p_share=0.77), wave=wave, pick=pick, stiffness_factor=13.0
        )
    else:
        experiment = PAPER.experiment(packing)
    return experiment.with_wave(law=law)


def hash_of_packing(packing: Packing) -> str:
    """Hash of places, contacts and forces."""
    preload, walls = packing.preload, packing.report.wall_stress
    return digest(packing.x, packing.y, packing.radius, packing.height, preload.pairs, preload.shear, walls)


def hash_of_cement(experiment: Experiment) -> str:
    """Hash of the order in which contacts are cemented."""
    orders = [experiment.ordering(seed) for seed in SEEDS]
    values = [(o.p_rank, o.p_content, o.first_cluster, o.c_content, o.centres) for o in orders]
    return digest(*(value for order in values for value in order))


def hashes_of_cells(cells: tuple[Measurement, ...]) -> Iterator[tuple[str, str]]:
    """Hashes of step, section and readings; of the check, which is that of a content."""
    sections = [cell.section for cell in cells]
    yield "step", digest(*((s.time_step, s.stability_limit, s.unbalanced_speed) for s in sections))
    yield (
        "section",
        digest(
            *((s.sampling_interval, s.start_time, *s.places) for s in sections),
            *(counts for s in sections for counts in (s.across, s.along)),
        ),
    )
    names = ("wave", "bias", "error", "peak", "first_arrival", "cross_correlation")
    stable = [cell.reading for cell in cells if cell.status is not CellStatus.UNSTABLE]
    numbers = [reading and getattr(reading, name) for reading in stable for name in names]
    yield "Vs", digest(*numbers, *(cell.vs for cell in cells))
    yield "check", digest(*astuple(cells[0].check)[1:])


def tell(value: str, name: str) -> None:
    """Print a line at once: whoever waits sees how far it is."""
    print(value, name, flush=True)  # noqa: T201 - a program


def main() -> None:
    """Print the hashes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", choices=("small", "paper"))
    parser.add_argument("--packing", type=Path)
    parser.add_argument("--laws", nargs="*", default=["linear", "finite"])
    parser.add_argument("--lanes", nargs="*", type=int, default=[1, 8])
    parser.add_argument("--contents", nargs="*", type=float, default=[0.0, 2.55])
    options = parser.parse_args()
    file = options.packing
    packing = packing_from_bytes(file.read_bytes()) if file is not None and file.exists() else packed(options.scene)
    if file is not None and not file.exists():
        file.write_bytes(packing_to_bytes(packing))
    tell(hash_of_packing(packing), "packing")
    tell(hash_of_cement(experiment_on(options.scene, packing, "linear")), "cement")
    for law, lanes, content in product(options.laws, options.lanes, options.contents):
        cells = measure(experiment_on(options.scene, packing, law), content, SEEDS[:lanes], lanes=lanes)
        for name, value in hashes_of_cells(cells):
            tell(value, f"{name}, {law}, lanes={lanes}, {content:g} %")


if __name__ == "__main__":
    main()
