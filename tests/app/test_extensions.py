"""A package adds a pattern of cement and a feature of a sample; so does an argument."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from forked import ForkedProgram
from places import CHECKOUT, TUTORIAL

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.config.checks import cross_check
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample import cement
from calcidem.dem.sample.cement import CementRule, draw_cement
from calcidem.dem.sample.packing import Packing

INSTALLED = """
import sys
import numpy as np
from calcidem.analysis.packing_graph import installed_features
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.config.checks import cross_check
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.cement import CementRule

rule = CementRule(drawn_by="layers", threshold=100.0)
assert not cross_check(Configuration(pattern=rule))
assert list(installed_features()) == ["cemented_below"]
with open_campaign(sys.argv[1]) as campaign:
    table = campaign.analyse().own_table
assert table["cemented_below"].attrs["long_name"] == "Share of cemented contacts below the middle of the sample"
assert bool(table["cemented_below"].notnull().any())
"""


@pytest.mark.slow
def test_an_installed_package_extends_calcidem(tmp_path: Path) -> None:
    """Its pattern is accepted by name, and its feature is in the analysis of every campaign."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    package = CHECKOUT / "examples" / "extension"
    subprocess.run([*command, "--target", str(tmp_path), str(package)], check=True)
    (program := tmp_path / "program.py").write_text(f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n{INSTALLED}")
    assert ForkedProgram(program, str(TUTORIAL)).wait(60.0) == 0


def test_a_pattern_of_the_program_orders_the_contacts(small_packing: Packing, monkeypatch: pytest.MonkeyPatch) -> None:
    """Contacts are cemented in its order, from the floor up; a name that is none, or half an order, is refused."""
    monkeypatch.setattr(cement, "GIVEN", {})
    rule = CementRule(drawn_by="up", threshold=100.0)
    (problem,) = cross_check(Configuration(pattern=rule))
    assert 'pattern.drawn_by = "up": no installed package has this pattern' in str(problem)
    cement.GIVEN.update({"up": lambda points, _: np.argsort(points[:, 1])})
    cemented = draw_cement(small_packing, rule, seed=1, root_seed=0).at(1.0).bonded
    height = small_packing.y[small_packing.pairs].mean(axis=1)
    assert cemented.any()
    assert height[cemented].max() < height[~cemented].min() + 2e-3  # m; contact points are not quite the means
    assert replace(Configuration(), pattern=rule).hash != Configuration().hash
    cement.GIVEN.update({"up": lambda points, _: np.arange(len(points) - 1)})
    with pytest.raises(ValueError, match="no permutation"):
        draw_cement(small_packing, rule, seed=1, root_seed=0)


def test_a_feature_of_the_program_is_in_the_analysis() -> None:
    """An argument gives it its name; its values are those of the function for each sample."""
    with open_campaign(TUTORIAL) as campaign:
        table = campaign.analyse(features={"share": lambda _, kinds: float(np.mean(kinds > 0))}).own_table
    known = table["share"].to_numpy()[np.isfinite(table["share"].to_numpy())]
    assert known.min() == 0.0 < known.max() < 1.0
