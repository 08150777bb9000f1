"""Numerical errors of scenes drawn at random against the finite law with a quarter of the step in double precision.

    python benchmarks/accuracy/drawn.py [--first 3000] [--scenes 100] [--stiff | --stiffest]

Boxes of 120 to 550 disks, any law, precision and transmitter; stiffness, cement, damping, amplitude and frequency over
decades. With `--stiff`: damping of 0.3 to 0.7 and bonds up to 1e5 times as stiff as the contacts.
With `--stiffest`: damping of 0.6 to 0.7, bonds 1e5 to 1e8 times as stiff, and nearly all contacts cemented. *Silent* is
a velocity off by more than 5 % and by more than 1.96 standard errors.
"""

import argparse
import math
from dataclasses import replace
from functools import cache

import numpy as np

from calcidem.dem.engine.fields import FieldError
from calcidem.dem.engine.scene import Cement, Sand
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.cement import CementCapacityError, CementRule
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import Packing, PackingRule
from calcidem.dem.wave.experiment import Experiment, WaveRule
from calcidem.dem.wave.measurement import Measurement, measure
from calcidem.dem.wave.static_speed import static_speed
from calcidem.storage.records import NORMAL_95

_PACKINGS, _SEEDS = 24, 8
_WRONG = 0.05  # of the velocity
_STRONG = 0.5  # damping with which little arrives after two wavelengths


def between(generator: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(generator.uniform(np.log(low), np.log(high))))


@cache
def packed(index: int) -> tuple[PackingRule, Sand, Packing]:
    """One of some packings of sands of .5 to 8 mm."""
    generator = np.random.default_rng([77, index])
    diameter = between(generator, 0.5e-3, 5e-3)
    width = diameter * generator.uniform(10.0, 22.0)
    rule = PackingRule(
        width=width,
        height=width * generator.uniform(1.0, 1.8),
        diameter=(diameter, diameter * generator.uniform(1.1, 1.6)),
        stress=between(generator, 2e3, 1e5),
        friction_preparation=generator.uniform(0.0, 0.4),
        porosity=generator.uniform(0.17, 0.2),
    )
    sand = Sand(shear_modulus=between(generator, 2e9, 5e10)) if generator.integers(2) else Sand()
    return rule, sand, make_packing(rule, sand, generator)


def drawn_scene(seed: int, *, stiff: bool = False, stiffest: bool = False) -> tuple[Experiment, float]:
    """A scene and its content, percent; its path has .8 to 4 wavelengths of a wave at the static speed."""
    generator = np.random.default_rng([5, seed])
    rule, sand, packing = packed(int(generator.integers(_PACKINGS)))
    damping = generator.uniform(0.6 if stiffest else 0.3 if stiff else 0.02, 0.7)
    stiff = stiff or stiffest
    wave = WaveRule(
        amplitude=between(generator, 1e-5, 2e-3),
        transmitter=("wall", "driven")[generator.integers(2)],
        transmitter_half_width=packing.height * generator.uniform(0.15, 0.48),
        receiver_half_width=packing.height * generator.uniform(0.15, 0.48),
        damping=damping,
        boundary_thickness=packing.height * generator.uniform(0.0, 0.2),
        law=("finite", "linear", "auto")[generator.integers(3)],
        precision=("float64", "float32")[generator.integers(2)],
        listening_depth=min(rule.diameter[1] * generator.uniform(1.5, 3.0), 0.25 * rule.width),
    )
    experiment = Experiment(
        packing=packing,
        sand=replace(sand, friction=max(generator.uniform(rule.friction_preparation, 1.1), 0.2)),
        cement=Cement(
            bond_modulus=between(generator, 1e9, 2e11),
            bond_stiffness_ratio=between(generator, 0.5, 3.0),
            tensile_strength=np.inf,
            cohesion=np.inf,
        ),
        cement_rule=CementRule(
            p_diameter=rule.diameter[0] * 0.5,
            c_diameter=rule.diameter[0] * 0.62,
            cluster_diameter=6.0 * rule.diameter[0],
            threshold=(0.66, 3.0)[generator.integers(2)],
        ),
        wave=wave,
        stiffness_factor=between(generator, 3e-4, 0.1) if stiff else between(generator, 1e-2, 1.5),
    )
    content = between(generator, 1.5, 2.5) if stiff else between(generator, 0.5, 2.5)
    if stiffest:
        experiment = replace(experiment, stiffness_factor=between(generator, 1e-4, 1e-3))
        content = between(generator, 4.0, 10.0)
    speed = static_speed(experiment, experiment.ordering(0).at(content).bonded).speed * generator.uniform(0.8, 1.3)
    frequency = generator.uniform(0.8, 2.0 if damping >= _STRONG else 4.0) * speed / rule.width
    table = ((0.0, 20.0), (frequency, frequency))
    return replace(experiment, wave=replace(wave, slowest=speed / 4.0), frequencies=table), content


def compared(one: Measurement, fine: Measurement) -> tuple[float, float, float] | None:
    """Relative difference of a velocity, its numerical and its whole standard error; None if one is missing."""
    if one.vs is None or fine.vs is None or one.reading is None or one.check.numerical_error is None:
        return None
    numerical = one.check.numerical_error
    whole = math.hypot(one.reading.error, numerical, one.check.pulse_effect or 0.0)
    return abs(one.vs / fine.vs - 1.0), numerical, whole


def main() -> None:
    """Draw, measure twice, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=3000)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--stiff", action="store_true")
    parser.add_argument("--stiffest", action="store_true")
    chosen = parser.parse_args()
    found: list[tuple[float, float, float]] = []
    of_scene: list[int] = []
    impossible = 0
    for seed in range(chosen.first, chosen.first + chosen.scenes):
        try:
            experiment, content = drawn_scene(seed, stiff=chosen.stiff, stiffest=chosen.stiffest)
            coarse = measure(experiment, content, range(_SEEDS))
        except (CementCapacityError, FieldError, ValueError):  # what the program refuses before a wave is sent
            impossible += 1
            continue
        if not any(each.vs for each in coarse):
            continue
        finer = replace(experiment, is_checked=False).with_wave(
            law="finite", precision="float64", step_fraction=coarse[0].check.step_fraction / 4.0
        )
        exact = measure(finer, content, range(_SEEDS))
        pairs = [compared(one, fine) for one, fine in zip(coarse, exact, strict=True)]
        found += [pair for pair in pairs if pair is not None]
        of_scene += [seed] * (len(found) - len(of_scene))
    table: Floats = np.array(found).reshape(-1, 3)
    off, numerical, whole = table.T
    silent = (off > _WRONG) & (off > NORMAL_95 * whole)
    print(f"{chosen.scenes} scenes, {impossible} refused beforehand, {len(off)} velocities")
    if len(off):
        print(f"error: median {np.median(off):.1e}, 99 % {np.quantile(off, 0.99):.1e}, largest {off.max():.1e}")
        print(f"within 1.96 numerical errors: {np.mean(off <= NORMAL_95 * numerical):.1%}; silent: {silent.sum()}")
        for number in np.flatnonzero(silent).tolist():
            print(f"silent: scene {of_scene[number]}, error {off[number]:.1%}, stated {whole[number]:.1%}")


if __name__ == "__main__":
    main()
