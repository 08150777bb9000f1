"""Packings are judged before a wave is sent."""

from dataclasses import replace

import numpy as np
import pytest

from calcidem.dem.engine.scene import Preload, Sand
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import (
    Packing,
    PackingRule,
    _densest_cover,
    deepest_overlap,
    expected_overlap,
    judge_disks,
    judge_stress,
)

SMALL = 1.0e-3
"""Mean diameter, m."""


def squash(stress: float, **options: float) -> tuple[Packing, Sand]:
    """Some 60 disks packed under a stress, and their material."""
    rule = PackingRule(width=6 * SMALL, height=9 * SMALL, diameter=(0.8 * SMALL, 1.2 * SMALL), stress=stress, **options)
    return make_packing(rule, Sand(), np.random.default_rng(3)), Sand()


def largest(packing: Packing) -> float:
    """Largest overlap of a packing over the smaller radius."""
    return deepest_overlap(packing.x, packing.y, packing.radius, packing.pairs)


@pytest.mark.slow
def test_a_crushed_packing_is_refused_with_a_stress_that_would_do() -> None:
    """Up to 7 % of a radius nothing is said, up to 10 % a warning; the stress that is named gives about 5 %."""
    packing, sand = squash(5e4)
    assert not [fault for fault in judge_disks(packing, sand) if fault.text.startswith("stress")]
    crushed, _ = squash(3e6)
    assert largest(crushed) > 0.1
    fault = judge_disks(crushed, sand)[0]
    assert fault.refused
    assert "largest overlap" in fault.text
    cure = float(fault.text.split("packing.stress = ")[1].split(" Pa")[0])
    assert 0.03 < largest(squash(cure)[0]) < 0.07
    deep = replace(crushed, radius=crushed.radius - (largest(crushed) - 0.08) / 2.0 * crushed.radius.min())
    warning = next(fault for fault in judge_disks(deep, sand) if fault.text.startswith("stress"))
    assert not warning.refused


def test_a_disk_pressed_into_a_wall_counts(small_packing: Packing) -> None:
    """As a disk pressed into another one does."""
    assert judge_disks(small_packing, Sand()) == ()
    lowest = int(np.argmin(small_packing.y))
    y = small_packing.y.copy()
    y[lowest] = 0.88 * small_packing.radius[lowest]
    apart = small_packing.pairs[(small_packing.pairs != lowest).all(axis=1)]
    pressed = replace(small_packing, y=y, preload=Preload(apart, np.zeros(len(apart))))
    (fault,) = judge_disks(pressed, Sand())
    assert fault.refused
    assert "12.0% of a radius" in fault.text


def test_a_stress_that_crushes_is_known_beforehand() -> None:
    """It goes with the power 2/3 of stress over modulus, and the values named are let through."""
    sand = Sand()
    low, high = expected_overlap(1e4, SMALL, sand), expected_overlap(8e4, SMALL, sand)
    assert high == pytest.approx(4.0 * low)
    fault = judge_stress(1e8, SMALL, sand)
    stress = float(fault.split("packing.stress = ")[1].split(" Pa")[0])
    modulus = float(fault.split("sand.shear_modulus = ")[2].split(" Pa")[0])
    assert judge_stress(stress, SMALL, sand) == ""
    assert judge_stress(1e8, SMALL, replace(sand, shear_modulus=modulus)) == ""


def test_disks_cover_at_most_what_florian_proved() -> None:
    """The hexagonal lattice is the densest of equal disks; the bound grows towards 1 with the ratio of sizes."""
    covers = [_densest_cover(ratio) for ratio in (1.0, 0.7, 0.2, 1e-6)]
    assert covers[0] == pytest.approx(np.pi / np.sqrt(12.0))
    assert covers == sorted(covers)
    assert covers[-1] == pytest.approx(1.0, abs=1e-5)


def test_porosity_and_contacts_that_disks_cannot_have_are_refused(small_packing: Packing) -> None:
    """Denser than the lattice, six contacts or more; loose ones are warned of, a good packing is not."""
    report = small_packing.report
    assert judge_disks(small_packing, Sand()) == ()
    for change, refused in (
        ({"porosity": 0.066}, True),
        ({"coordination_number_without_rattlers": 6.0}, True),
        ({"porosity": 0.35}, False),
        ({"coordination_number_without_rattlers": 2.5}, False),
    ):
        (fault,) = judge_disks(replace(small_packing, report=replace(report, **change)), Sand())
        assert fault.refused is refused
    isostatic = replace(report, coordination_number_without_rattlers=3.0)
    assert judge_disks(replace(small_packing, report=isostatic), Sand()) == ()
