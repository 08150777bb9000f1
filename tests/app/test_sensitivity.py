"""The command `sensitivity`: variants of a small campaign, computed, continued and tabulated."""

from pathlib import Path

import pytest
import xarray as xr

from calcidem.app.config.schema import ConfigurationError
from calcidem.app.studies.sensitivity import (
    REFERENCE,
    compute_variants,
    read_variants,
    variant_changes,
    variant_table,
    vary_one,
)
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


def planned(folder: Path, plan: str = PLAN) -> Path:
    """Write base and plan into a folder."""
    (folder / "base.toml").write_text(BASE, encoding="utf-8")
    path = folder / "plan.toml"
    path.write_text(plan, encoding="utf-8")
    return path


def test_variants_differ_from_the_base_in_what_they_say(tmp_path: Path) -> None:
    """The reference is the base; a variant has its value, and a key left out has its default."""
    reference, modulus, calcite = read_variants(planned(tmp_path), str(tmp_path / "all.db"))
    assert reference.name == REFERENCE
    assert reference.configuration.pattern.cluster_area == 3.6e-6
    assert modulus.configuration.cement.bond_modulus == 1.28e12
    assert modulus.configuration.pattern == reference.configuration.pattern
    assert calcite.configuration.pattern.cluster_area is None
    assert len({variant.configuration.hash for variant in (reference, modulus, calcite)}) == 3


def test_a_variant_has_the_disks_of_its_base_and_the_cells_of_the_plan(tmp_path: Path) -> None:
    """A file of disks is beside the base; parts and further seeds of the base are none of the study's."""
    rows = (f"{0.00107 + 0.00214 * i},{0.001 + 0.002 * k},0.001\n" for i in range(14) for k in range(30))
    path, disks = planned(tmp_path), "x,y,radius\n" + "".join(rows)
    (tmp_path / "own.csv").write_text(disks, encoding="utf-8")
    own = BASE.replace("height = 0.06", 'file = "own.csv"') + '[run]\npart = "1/2"\n'
    (tmp_path / "base.toml").write_text(own, encoding="utf-8")
    reference = read_variants(path, str(tmp_path / "all.db"))[0].configuration
    assert reference.packing_draw.file == str(tmp_path / "own.csv")
    assert reference.run.part is None
    (tmp_path / "base.toml").write_text(
        BASE + "[campaign]\nmost_seeds = 9\nuntil = { mean = 0.05 }\n", encoding="utf-8"
    )
    assert read_variants(path, str(tmp_path / "all.db"))[0].configuration.campaign.until is None


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
        (('set = { "cement.bond_modulus" = 1.28e12 }', "seeds = 9"), 'changes no value of "reference"'),
        (
            ('value = "Eq. 2"', 'value = "Eq. 2"\ncontents = [0.0, 0.66]'),
            'contents = 0: "modulus: sixteen times" has no',
        ),
    ],
)
def test_mistakes_in_a_plan_are_named(change: tuple[str, str], named: str, tmp_path: Path) -> None:
    """Whatever is wrong with a plan is told before anything is computed."""
    path = planned(tmp_path, PLAN.replace(*change))
    with pytest.raises(ConfigurationError, match=named):
        read_variants(path, str(tmp_path / "all.db"))


def test_a_section_that_is_none_is_refused(tmp_path: Path) -> None:
    """A number where the configuration of a plan has to have a section is named."""
    path = planned(tmp_path)
    (tmp_path / "base.toml").write_text("run = 3", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="run"):
        read_variants(path, str(tmp_path / "all.db"))


def test_stiffer_cement_is_faster_and_nothing_is_computed_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sixteen times the modulus of the bonds raises mean Vs; a second call adds no attempt and gives the same table."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(tmp_path / "cache"))
    variants = read_variants(planned(tmp_path), str(tmp_path / "all.db"))[:2]
    compute_variants(variants, lambda _: None)
    (change,) = variant_changes(variants)[variants[1].name]
    assert change.planned == 8
    assert change.measured >= 4  # a box this small swallows some pulses and makes some velocities too uncertain
    assert change.mean_ratio > 1.02
    table = variant_table(variants).text
    assert table.count("\n") == 4
    assert f"{change.mean:.0f} ± {change.standard_deviation:.0f}" in table
    compute_variants(variants, lambda _: None)
    assert variant_table(variants).text == table
    changed = read_variants(planned(tmp_path, PLAN.replace("1.28e12", "1.3e12")), str(tmp_path / "all.db"))[:2]
    with pytest.raises(CampaignMismatchError, match="bond_modulus"):  # the numbers are those of the former plan
        variant_table(changed)


@pytest.mark.parametrize(("varied", "head"), [("damping", "0.3 |"), ("frequency", "0.3 Hz |")])
def test_values_have_their_unit(varied: str, head: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A frequency has one, and a factor has none."""
    vs = xr.DataArray([[500.0]], dims=("content", varied), coords={"content": [5.0], varied: [0.3]}, name="vs_peak")
    monkeypatch.setattr("calcidem.app.studies.sensitivity.run_studies", lambda *_, **__: {varied: vs.to_dataset()})
    told = vary_one(varied, "any.db", None, None).text
    assert f"| content, % | {head}" in told
    assert told.startswith("Mean Vs from peak to peak, m/s, of 1 sample.")
    near = vs.to_dataset().assign_attrs(distance=1000.0).assign(frequency=vs[varied].variable * 0.0 + 0.3)
    monkeypatch.setattr("calcidem.app.studies.sensitivity.run_studies", lambda *_, **__: {varied: near})
    assert "| 5 | 500 * |" in vary_one(varied, "any.db", None, None).text


def test_the_plan_of_the_documentation_is_good(tmp_path: Path) -> None:
    """Every variant in the plans that the reproduction pages were made with can be read."""
    plans = Path(__file__).parents[2] / "docs" / "reproduction"
    for plan in plans.glob("*.toml"):
        assert len(read_variants(plan, str(tmp_path / "all.db"))) > 1
