"""The command `sensitivity`: variants of a small campaign, computed, continued and tabulated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from calcidem.app.config.errors import ConfigurationError
from calcidem.app.studies.sensitivity.plan import (
    REFERENCE,
    VariantPlan,
)
from calcidem.app.studies.sensitivity.sobol import (
    SobolPlan,
    _parameters_by_weight,
    _sobol_table,
    _verdicts,
)
from calcidem.dem.sample.packing import Packing
from calcidem.storage.errors import CampaignMismatchError

pytestmark = pytest.mark.slow

BASE = """
[packing]
width = 0.03
height = 0.06
unbalanced_force_ratio = 1e-5
[sand]
wave_stiffness_factor = 13.0
[pattern]
cluster_area = 3.6e-6
[wave]
transmitter_half_width = 0.01
receiver_half_width = 0.012
listening_depth = 0.006
boundary_thickness = 0.012
[wave.frequency]
content = [0.0, 0.66]
frequency = [12e3, 24e3]
"""

PLAN = """
configuration = "base.toml"
contents = [0.66]
seeds = 8
[[variant]]
choice = "modulus"
value = "sixteen times"
set = { "cement.bond_modulus" = 1.28e12 }
[[variant]]
choice = "calcite of a cluster"
value = "Eq. 2"
without = ["pattern.cluster_area"]
against = "modulus: sixteen times"
"""

RANGES = """
configuration = "base.toml"
contents = [0.66, 0.5]
seeds = 8
[ranges]
"sand.wave_stiffness_factor" = [8.0, 20.0]
"cement.bond_modulus" = [7.9e10, 8.1e10]
"""


def planned(folder: Path, plan: str = PLAN) -> Path:
    """Write base and plan into a folder."""
    (folder / "base.toml").write_text(BASE, encoding="utf-8")
    path = folder / "plan.toml"
    path.write_text(plan, encoding="utf-8")
    return path


def test_variants_differ_from_the_base_in_what_they_say(tmp_path: Path) -> None:
    """The reference is the base; a variant has its value, and a key left out has its default."""
    reference, modulus, calcite = VariantPlan.load(planned(tmp_path), str(tmp_path / "all.db")).variants
    assert reference.name == REFERENCE
    assert reference.configuration.pattern.cluster_area == 3.6e-6
    assert modulus.configuration.cement.bond_modulus == 1.28e12
    assert modulus.configuration.pattern == reference.configuration.pattern
    assert calcite.configuration.pattern.cluster_area is None
    assert len({variant.configuration.hash for variant in (reference, modulus, calcite)}) == 3


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (("bond_modulus", "bond_modulos"), "cement.bond_modulos"),
        (('against = "modulus: sixteen times"', 'against = "modulus"'), "against"),
        (("seeds = 8", "seeds = 1"), "seeds"),
        (("seeds = 8", "seed = 8"), "seed"),
        (('value = "Eq. 2"', 'value = "Eq/2"'), "name"),
        (("base.toml", "lost.toml"), "lost.toml"),
        (('without = ["pattern', 'without = ["patern'), "patern"),
    ],
)
def test_mistakes_in_a_plan_are_named(change: tuple[str, str], named: str, tmp_path: Path) -> None:
    """Whatever is wrong with a plan is told before anything is computed."""
    path = planned(tmp_path, PLAN.replace(*change))
    with pytest.raises(ConfigurationError, match=named):
        VariantPlan.load(path, str(tmp_path / "all.db"))


def test_a_section_that_is_none_is_refused(tmp_path: Path) -> None:
    """A number where the configuration of a plan has to have a section is named."""
    path = planned(tmp_path)
    (tmp_path / "base.toml").write_text("run = 3", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="run"):
        VariantPlan.load(path, str(tmp_path / "all.db"))


def test_stiffer_cement_is_faster_and_nothing_is_computed_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sixteen times the modulus of the bonds raises mean Vs; a second call adds no attempt and gives the same table."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(tmp_path / "cache"))
    variants = VariantPlan(VariantPlan.load(planned(tmp_path), str(tmp_path / "all.db")).variants[:2])
    variants.compute(lambda _: None)
    found = variants.changes()
    (change,) = found[variants.variants[1].name]
    assert change.planned == 8
    assert change.measured >= 4  # a box this small swallows some pulses and makes some velocities too uncertain
    assert change.mean_ratio > 1.02
    table = variants.result().text
    assert table.count("\n") == 4
    assert f"{change.mean:.0f} ± {change.standard_deviation:.0f}" in table
    variants.compute(lambda _: None)
    assert variants.result().text == table


def test_the_plan_of_the_documentation_is_good(tmp_path: Path) -> None:
    """Every variant and every range in the plans that the reproduction pages were made with can be read."""
    plans = Path(__file__).parents[2] / "docs" / "reproduction"
    for plan in plans.glob("*.toml"):
        if "[ranges]" in plan.read_text(encoding="utf-8"):
            assert SobolPlan.load(plan, 4).ranges
        else:
            assert len(VariantPlan.load(plan, str(tmp_path / "all.db")).variants) > 1


def test_ranges_that_cannot_be_varied_are_named(tmp_path: Path) -> None:
    """A plan without ranges, a number of the packing, and odd numbers of points are refused before anything runs."""
    for change, bases, named in (
        (("[ranges]", "[[variant]]"), 8, "choice"),
        (('"sand.wave_stiffness_factor"', '"packing.stress"'), 8, "packing.stress: is not a number"),
        (("[8.0, 20.0]", "[8.0]"), 8, "ranges"),
        (("[8.0, 20.0]", "[20.0, 8.0]"), 8, "two increasing"),
        (("seeds = 8", "seeds = 8"), 12, "power of two"),
    ):
        with pytest.raises(ConfigurationError, match=named):
            SobolPlan.load(planned(tmp_path, RANGES.replace(*change)), bases)


def test_points_that_are_stored_are_divided_as_the_closed_form_says(tmp_path: Path) -> None:
    """Velocities whose mean is linear in one parameter and deviation in the other give each its share, and no other."""
    plan = SobolPlan.load(planned(tmp_path, RANGES), 128)
    points = plan.stored(tmp_path / "none.nc")
    nothing = _parameters_by_weight(plan.indices(points))
    assert not any(nothing.values())  # nothing is known before anything is computed
    low, high = np.array(list(plan.ranges.values())).T
    first, second = ((points["value"].to_numpy() - low) / (high - low)).T
    signs = np.tile([1.0, -1.0], 4)
    mean = 300.0 + 100.0 * first
    points["vs"][:] = (mean[:, None] * (1.0 + 0.1 * second[:, None] * signs))[:, None, :]
    points["vs"][:, 1, 0] = 100.0  # the second content varies differently; its last seed is never read
    points["vs"][:, 1, 7] = np.nan
    points["done"][:] = True
    indices = plan.indices(points)
    found = indices.sel(content=0.66)
    for output, shares in (("mean", [1.0, 0.0]), ("relative_deviation", [0.0, 1.0])):
        np.testing.assert_allclose(found["total"].sel(output=output), shares, atol=0.02)
        np.testing.assert_allclose(found["first"].sel(output=output), shares, atol=0.1)
    assert bool(indices["total"].sel(output="readable_share").isnull().all())
    assert "does not vary" in _sobol_table(indices)
    assert f"{mean.min():.3g} to {mean.max():.3g}" in _sobol_table(indices)
    totals = indices[["total", "total_half_width"]]
    only_mean = indices.assign(totals.where(indices["output"] != "relative_deviation", 0.0))
    one = only_mean.sel(content=[0.66])
    expected = {"matters": ["sand.wave_stiffness_factor"], "negligible": ["cement.bond_modulus"], "undecided": []}
    assert _parameters_by_weight(one) == expected


def test_what_few_points_do_not_show_is_not_called_negligible(tmp_path: Path) -> None:
    """A parameter whose interval is wide, or narrow from a few base points, is not decided, and the table says so."""
    plan = SobolPlan.load(planned(tmp_path, RANGES), 128)
    both = ["mean", "relative_deviation"]
    totals = xr.Dataset(
        {
            "total": (("output", "content", "parameter"), np.full((2, 1, 2), 0.03)),
            "total_half_width": (("output", "content", "parameter"), [[[0.01, 0.2]], [[0.01, 0.2]]]),
            "bases": (("output", "content"), [[128], [128]]),
        },
        coords={"output": both, "content": [0.66], "parameter": list(plan.ranges)},
    )
    names = list(plan.ranges)
    assert _parameters_by_weight(totals) == {"matters": [], "negligible": names[:1], "undecided": names[1:]}
    few = _parameters_by_weight(totals.assign(bases=totals["bases"] // 16))
    assert few == {"matters": [], "negligible": [], "undecided": names}
    assert _verdicts(totals)[1].startswith("Not decided from 128 base points: cement.bond_modulus")


def test_points_are_computed_once_and_of_one_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_packing: Packing
) -> None:
    """A file that lacks a point is completed to the same velocities; one of another plan is refused."""
    one = RANGES.replace("[0.66, 0.5]", "[0.66]").replace('"cement.bond_modulus" = [7.9e10, 8.1e10]\n', "")
    plan = SobolPlan.load(planned(tmp_path, one), 4)
    file, told = tmp_path / "points.nc", []
    complete = plan.evaluate(small_packing, file, say=told.append)
    assert told[0].startswith("12 points of 8 cells each: about")
    assert bool(complete["done"].all())
    assert bool(complete["vs"].notnull().any("seed").all())
    monkeypatch.setattr("calcidem.app.studies.sensitivity.sobol.trial_workers", None)  # nothing is left to compute
    assert plan.evaluate(small_packing, file)["vs"].equals(complete["vs"])
    with pytest.raises(CampaignMismatchError, match="another plan"):
        replace(plan, bases=8).stored(file)
    monkeypatch.undo()
    partial = complete.copy(deep=True)
    partial["done"][3], partial["vs"][3] = False, np.nan
    partial.to_netcdf(file)
    assert plan.evaluate(small_packing, file)["vs"].equals(complete["vs"])


@pytest.mark.full
def test_the_stiffness_of_the_sand_decides_where_little_is_cemented(tmp_path: Path, small_packing: Packing) -> None:
    """Of a small real campaign the mean at 0.66 % is decided by the sand, not by 1 % of the modulus of the bonds."""
    plan = SobolPlan.load(planned(tmp_path, RANGES.replace("0.5]", "0.4]")), 64)
    points = plan.evaluate(small_packing, tmp_path / "points.nc", cores=2)
    total = plan.indices(points)["total"].sel(output="mean", content=0.66)
    assert float(total[0]) > 0.8  # seeds that some points do not read make the rest
    assert float(total[1]) < 0.1
