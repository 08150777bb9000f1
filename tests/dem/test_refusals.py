import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import HERTZ, RADIUS, pair_scene
from test_distance import lattice_experiment

from calcidem.dem.engine.readout import contact_forces, energies
from calcidem.dem.engine.scene import Bonds, Cement, Installation, Preload, Sand, Scene, Wall
from calcidem.dem.engine.state import advance, start
from calcidem.dem.kernels.layout import Features
from calcidem.dem.sample.packing import PackingRule
from calcidem.dem.wave import propagation
from calcidem.dem.wave.propagation import _refuse_short_pulse

ONE = np.zeros(1)
TWO = np.array([[0, 1]])
NAN = float("nan")
begin = partial(start, features=HERTZ)  # whose kernel other tests have, too


def disk(**options: object) -> Scene:
    """One disk."""
    return Scene(**{"x": ONE, "y": ONE, "radius": ONE + RADIUS, **options})  # type: ignore[arg-type]


# What is built, then what the message has to name: field, value and a word of the cure.
CASES: list[tuple[Callable[[], object], str, str, str]] = [
    (lambda: Sand(shear_modulus=-1.0), "shear_modulus", "-1.0", "positive"),
    (lambda: Sand(shear_modulus=NAN), "shear_modulus", "nan", "positive"),
    (lambda: Sand(poisson_ratio=0.5), "poisson_ratio", "0.5", "(-1, 0.5)"),
    (lambda: Sand(density=0.0), "density", "0.0", "positive"),
    (lambda: Sand(friction=-0.1), "friction", "-0.1", "0 or more"),
    (lambda: Cement(bond_modulus=0.0), "bond_modulus", "0.0", "positive"),
    (lambda: Cement(linear_modulus=-1.0), "linear_modulus", "-1.0", "0 or more"),
    (lambda: Cement(bond_stiffness_ratio=0.0), "bond_stiffness_ratio", "0.0", "positive"),
    (lambda: Cement(tensile_strength=-5.0), "tensile_strength", "-5.0", "positive"),
    (lambda: Cement(cohesion=0.0), "cohesion", "0.0", "positive"),
    (lambda: Cement(friction_angle=90.0), "friction_angle", "90.0", "[0, 90)"),
    (lambda: Wall((0.0, 0.0), (1.0, 1.0)), "normal", "[1.0, 1.0]", "length 1"),
    (lambda: Wall((0.0, 0.0), (1.0, 0.0, 0.0)), "normal", "[1.0, 0.0, 0.0]", "two"),  # type: ignore[arg-type]
    (lambda: Wall((NAN, 0.0), (1.0, 0.0)), "point", "nan", "finite"),
    (lambda: Wall((0.0, 0.0), (1.0, 0.0), velocity=(0.0, np.inf)), "velocity", "inf", "finite"),
    (lambda: Wall((0.0, 0.0), (1.0, 0.0), friction=-0.1), "friction", "-0.1", "0 or more"),
    (lambda: Wall((0.0, 0.0), (1.0, 0.0), span=(1.0, 1.0)), "span", "[1.0, 1.0]", "lower < upper"),
    (lambda: Wall((0.0, 0.0), (1.0, 0.0), servo_speed=0.0), "servo_speed", "0.0", "positive"),
    (lambda: Wall((0.0, 0.0), (1.0, 0.0), servo_speed=np.inf), "servo_speed", "inf", "positive"),
    (lambda: Wall((0.0, 0.0), (1.0, 0.0), servo_gain=1.5), "servo_gain", "1.5", "(0, 1]"),
    (lambda: Wall((0.0, 0.0), (1.0, 0.0), servo_force=NAN), "servo_force", "nan", "positive"),
    (lambda: Wall((0.0, 0.0), (1.0, 0.0), servo_force=-1.0), "servo_force", "-1.0", "positive"),
    (lambda: Bonds(np.array([0, 1])), "bonds.pairs", "(2,)", "(B, 2)"),
    (lambda: Bonds(np.array([[0.0, 1.0]])), "bonds.pairs", "float64", "whole"),
    (lambda: Bonds(np.array([[1, 1]])), "bonds.pairs", "itself", "different"),
    (lambda: Bonds(TWO, lanes=np.zeros(2, np.uint32)), "bonds.lanes", "(2,)", "(1,)"),
    (lambda: Bonds(TWO, installation="glue"), "installation", "glue", "preserve"),  # type: ignore[arg-type]
    (lambda: Bonds(TWO, installation="pfc_absolute"), "installation", "pfc_absolute", "linear_modulus"),
    (lambda: disk(x=np.zeros(2)), "x", "(2,)", "(1,)"),
    (lambda: disk(y=ONE + NAN), "y", "NaN", "finite"),
    (lambda: disk(radius=-ONE), "radius", "0.0", "positive"),
    (lambda: disk(radius=np.zeros(0)), "radius", "empty", "at least one"),
    (lambda: disk(damping=1.5), "damping", "1.5", "[0, 1]"),
    (lambda: disk(damping=NAN), "damping", "nan", "[0, 1]"),
    (lambda: disk(damping=np.zeros(3)), "damping", "(3,)", "(1,)"),
    (lambda: disk(held=np.zeros(2, bool)), "held", "(2,)", "(1,)"),
    (lambda: disk(held=ONE + 0.5), "held", "float64", "True or False"),
    (lambda: disk(walls=Wall((0.0, 0.0), (1.0, 0.0))), "walls", "a single wall", "tuple"),  # type: ignore[arg-type]
    (lambda: disk(load=np.zeros((1, 2))), "load", "(1, 2)", "(1, 3)"),
    (lambda: disk(load=np.full((1, 3), NAN)), "load", "NaN", "finite"),
    (lambda: disk(bonds=Bonds(TWO)), "bonds.pairs", "0 to 1", "0 to 0"),
    (lambda: begin(pair_scene(gap=-2.0 * RADIUS)), "x, y", "one centre", "own"),
    (lambda: begin(disk(), time_step=1.0), "time_step", "1.0", "smaller"),
    (lambda: begin(disk(), time_step=0.0), "time_step", "0.0", "positive"),
    (lambda: begin(disk(), step_fraction=1.5), "time_step", "above the critical time step", "smaller"),
    (lambda: begin(disk(), velocity=np.zeros(2)), "velocity", "(2,)", "(1, 2)"),
    (lambda: begin(disk(), velocity=np.full((1, 2), NAN)), "velocity", "NaN", "finite"),
    (lambda: begin(disk(), spin=np.zeros(2)), "spin", "(2,)", "(1,)"),
    (lambda: begin(pair_scene(), preload=Preload(TWO, np.zeros(2))), "preload.pairs", "(1, 2)", "(2, 2)"),
    (lambda: begin(disk(), preload=Preload(TWO, ONE)), "preload.pairs", "0 to 1", "0 to 0"),
    (lambda: begin(pair_scene(), preload=Preload(TWO, ONE + NAN)), "preload.shear", "NaN", "finite"),
    (lambda: begin(pair_scene(), skin_fraction=0.0), "skin_fraction", "0.0", "positive"),
    (lambda: begin(pair_scene(), skin_fraction=NAN), "skin_fraction", "nan", "positive"),
    (lambda: begin(pair_scene(), steps_per_contact=-1.0), "steps_per_contact", "-1.0", "0 or more"),
    (lambda: begin(disk(), time_step=np.full(2, 1e-9)), "time_step", "(2,)", "(1,)"),
    (lambda: begin(disk(), precision="float16"), "precision", "float16", "float64, float32"),  # type: ignore[arg-type]
    (lambda: begin(disk(walls=(Wall((9.0, 0.0), (1.0, 0.0)),))), "x, y", "disks [0]", "side"),
    (lambda: advance(begin(disk()), -5), "steps", "-5", "0 or more"),
    (lambda: advance(begin(disk()), 2.5), "steps", "2.5", "whole"),  # type: ignore[arg-type]
    (lambda: Features(lanes=0), "lanes", "0", "8, 16 or 32"),
    (lambda: Features(lanes=3), "lanes", "3", "8, 16 or 32"),
    (lambda: Features(linear=True), "linear", "True", "switch"),
    (lambda: Features(breakage=True), "breakage", "cemented", "bonds = True"),
    (lambda: start(pair_scene(), law="small"), "law", "small", "finite, linear"),  # type: ignore[arg-type]
    (lambda: contact_forces(start(pair_scene(), law="linear")), "law", "linear", "finite"),
    (lambda: energies(start(pair_scene(), law="linear")), "law", "linear", "finite"),
    (lambda: PackingRule(width=0.0), "width", "0.0", "positive"),
    (lambda: PackingRule(height=-1.0), "height", "-1.0", "positive"),
    (lambda: PackingRule(diameter=(3e-3, 2e-3)), "diameter", "0.003", "smallest"),
    (lambda: PackingRule(width=0.01), "diameter", "0.003", "4 disks"),
    (lambda: PackingRule(porosity=0.05), "porosity", "0.05", "0.1 and 0.35"),
    (lambda: PackingRule(expansion_steps=0), "expansion_steps", "0", "[1, 100]"),
    (lambda: PackingRule(friction_preparation=-0.1), "friction_preparation", "-0.1", "0 or more"),
    (lambda: PackingRule(stress=0.0), "stress", "0.0", "positive"),
    (lambda: PackingRule(damping=1.0), "damping", "1.0", "(0, 1)"),
    (lambda: PackingRule(unbalanced_force_ratio=0.1), "unbalanced_force_ratio", "0.1", "(0, 0.001]"),
    (lambda: PackingRule(most_steps=0), "most_steps", "0", "1 or more"),
]


@pytest.mark.parametrize(("build", "field", "value", "cure"), CASES, ids=[f"{case[1]} {case[2]}" for case in CASES])
def test_misuse_is_refused_with_field_value_and_cure(
    build: Callable[[], object], field: str, value: str, cure: str
) -> None:
    """The message begins with the field, shows what was given and says what to give instead."""
    with pytest.raises(ValueError, match=re.escape(field)) as error:
        build()
    message = str(error.value)
    assert value in message
    assert cure in message
    assert message.index(value) < message.rindex(cure)


def test_a_pair_that_is_named_twice_is_bonded_in_the_lanes_of_both() -> None:
    """Naming a bond once in each direction unites its lanes."""
    bonds = Bonds(np.array([[0, 1], [1, 0]]), lanes=np.array([1, 2], np.uint32))
    state = start(pair_scene(bonds=bonds), features=Features(bonds=True, lanes=4), steps_per_contact=0.0)
    assert state.assembly.pairs.cemented.tolist() == [3]


def test_a_pulse_may_be_as_short_as_its_refusal_says() -> None:
    """Twenty steps are enough."""
    step = 2.0**-20
    _refuse_short_pulse(step, 0.05 / step)
    with pytest.raises(ValueError, match=r"frequency = .* 20 time steps of 9\.54e-07 s, .* at most 52428 Hz"):
        _refuse_short_pulse(step, 0.0501 / step)


def test_samples_are_prepared_only_where_their_steps_or_forces_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pulse that is long for sand needs no sample; bonds that change the forces need the packing without them."""
    prepared: list[tuple[list[int], float]] = []
    monkeypatch.setattr(
        propagation,
        "prepare_recorder",
        lambda _experiment, bonded, frequency, *_: prepared.append(([int(flags.sum()) for flags in bonded], frequency)),
    )
    experiment = lattice_experiment(3)
    experiment = replace(experiment, wave=replace(experiment.wave, law="finite"))
    limit = 0.05 / (experiment.wave.step_fraction * propagation._limit_of_all_patterns(experiment, cemented=False))
    orderings = [experiment.ordering(1)]
    count = int(orderings[0].at(9.0).bonded.sum())
    cases: list[tuple[Installation, float, list[tuple[list[int], float]]]] = [
        ("preserve", 0.99, []),
        ("preserve", 1.01, [([count], 1.01 * limit)]),
        ("zero", 0.3, [([0], 0.3 * limit)]),
        ("zero", 0.9, [([0], 0.5 * limit)]),
    ]
    for installation, share, expected in cases:
        given = replace(experiment, installation=installation, frequencies=((0.0, 9.0), (share * limit, share * limit)))
        prepared.clear()
        propagation.refuse_unfit_samples(given, 9.0, lambda: orderings, 1)
        assert [flags for flags, _ in prepared] == [flags for flags, _ in expected]
        assert [frequency for _, frequency in prepared] == pytest.approx([frequency for _, frequency in expected])
