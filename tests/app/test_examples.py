"""Examples on the public interface run, and do what they say."""

import importlib.util
import json
import shutil
import zipfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from places import CHECKOUT, TUTORIAL
from scipy import stats

import calcidem


def example(name: str) -> ModuleType:
    """One of the files in ``examples``."""
    spec = importlib.util.spec_from_file_location(name, CHECKOUT / "examples" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SMALL = """
[campaign]
seeds = 3
contents = [0.66]
[packing]
width = 0.03
height = 0.06
unbalanced_force_ratio = 1e-5
[sand]
wave_stiffness_factor = 13.0
[pattern]
p_share = 0.77
[wave]
transmitter_half_width = 0.01
receiver_half_width = 0.012
boundary_thickness = 0.012
listening_depth = 0.006
frequency = 24e3
"""
"""The disks of `small_configuration`."""


@pytest.mark.slow
@pytest.mark.usefixtures("cached_packing")
def test_sobol_indices_of_a_campaign_and_of_a_closed_form(tmp_path: Path) -> None:
    """Four points of a real campaign are computed once; the Ishigami function has its total indices."""
    pytest.importorskip("SALib", reason="SALib is not installed")
    sobol = example("sobol_indices")
    (tmp_path / "small.toml").write_text(SMALL, encoding="utf-8")
    ranges = {"sand.wave_stiffness_factor": (8.0, 20.0), "cement.bond_modulus": (7.9e10, 8.1e10)}
    words = str(tmp_path / "small.toml"), str(tmp_path / "points.db"), ranges, 1
    vs = sobol.compute(*words)
    assert vs.shape == (4, 3, 1)
    assert np.isfinite(vs).any(axis=1).all()
    np.testing.assert_array_equal(sobol.compute(*words), vs)
    three = dict.fromkeys("abc", (-np.pi, np.pi))
    x = sobol.sampling.sample(sobol.problem(three), 1024, calc_second_order=False, seed=1).T
    output = np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])
    output[[0, 3, 777]] = np.nan  # of two base points
    first, second, both = 0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 49.0 / 8, 0.01 * np.pi**8 * 8 / 225
    expected = np.array([first + both, second, both]) / (first + second + both)
    np.testing.assert_allclose(sobol.total_indices(three, output)[0], expected, atol=0.03)
    assert np.isnan(sobol.total_indices(three, np.ones(5 * 16))[0]).all()


def test_two_campaigns_are_compared(small_database: Path) -> None:
    """Intervals are those of SciPy's tests; the figure has two panels, and differing keys are named."""
    module = example("compare_campaigns")
    one, other = np.random.default_rng(1).normal(500.0, [[30.0], [50.0]], (2, 9))
    welch = stats.ttest_ind(one, other[:5], equal_var=False).confidence_interval()
    assert module.half_width(one, other[:5]) == pytest.approx(0.5 * (welch.high - welch.low))
    paired = stats.ttest_1samp(one - other, 0.0).confidence_interval()
    assert module.half_width(one - other) == pytest.approx(0.5 * (paired.high - paired.low))
    with calcidem.open_campaign(small_database) as small, calcidem.open_campaign(TUTORIAL) as quick:
        table = module.compare(small, quick)
        assert table.loc[5.0, "other mean"] == pytest.approx(float(quick.vs().sel(content=5.0).mean()))
        assert table.loc[5.0, "pairs"] == 0  # on other packings the same seed is another sample
        assert np.isnan(table[["paired", "paired +-"]].to_numpy(dtype=float)).all()
        assert 0.0 not in table.index  # where all seeds are one sample
        assert "packing.width" in module.differing(small, quick)
        same = module.compare(quick, quick)
        assert not same[["paired", "paired +-"]].to_numpy().any()
        assert same.loc[5.0, "pairs"] == same.loc[5.0, "n"]
        assert not module.differing(quick, quick)
    assert len(module.draw(table, ("small", "quick")).axes) == 2


@pytest.mark.full  # two samples of 4,700 disks are sheared over 4,000 steps
def test_cement_stiffens_a_sample_and_makes_it_uneven() -> None:
    """Stiffness in windows has the mean of the static speed; with more cement it is larger and scatters more."""
    module = example("random_field")
    with calcidem.open_campaign(TUTORIAL) as campaign:
        found = [
            module.describe(np.log(module.modulus(campaign, 1, content, 0.012)).expand_dims("seed"))
            for content in (0.66, 5.0)
        ]
        speed = campaign.static_speed(seed=1, content=0.66).speed
    little, much = found
    # Density of the grains times their share of the area. Windows outside of the strip of the wave count, too, and in
    # patches of 12 mm they are unlike those inside.
    assert little["geometric_mean"] == pytest.approx(0.81 * 2650.0 * speed**2, rel=0.4)
    assert much["geometric_mean"] > 5.0 * little["geometric_mean"]
    assert much["log_deviation"] > little["log_deviation"]
    assert max(one["unknown"] for one in found) < 0.05


def test_averages_over_a_window_have_its_side_as_their_scale() -> None:
    """Averages of uncorrelated values over 6 steps of 0.5 along x and 3 of 0.25 along y have scales of 3 and 0.75."""
    module = example("random_field")
    noise = np.random.default_rng(3).standard_normal((60, 62, 65))
    averaged = np.lib.stride_tricks.sliding_window_view(noise, (3, 6), axis=(1, 2)).mean(axis=(-2, -1))
    averaged[:, 5, 7] = np.nan
    places = {"y": 0.25 * np.arange(averaged.shape[1]), "x": 0.5 * np.arange(averaged.shape[2])}
    found = module.describe(xr.DataArray(averaged, places, ("seed", "y", "x")))
    assert (found["scale_x"], found["scale_y"]) == pytest.approx((3.0, 0.75), rel=0.08)
    assert found["log_deviation"] == pytest.approx(float(np.nanstd(averaged)))
    assert found["unknown"] == pytest.approx(1.0 / averaged[0].size)
    assert np.isnan(module.scale_of_fluctuation(xr.DataArray(np.ones((2, 3, 4)), dims=("seed", "y", "x")), "x"))


def test_errors_of_own_predictors_are_those_of_fits_without_the_sample(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each error is that of least squares by hand on the other samples; the program has a line for each set."""
    module = example("own_predictor")
    draws = np.random.default_rng(4)
    features = draws.normal(size=(30, 2))
    vs = 800.0 * np.exp(features @ [0.1, -0.05] + draws.normal(0.0, 0.05, 30))
    errors = module.left_out_errors(features, vs)
    for out in (0, 17):
        design = np.column_stack([np.ones(29), np.delete(features, out, axis=0)])
        solution = np.linalg.lstsq(design, np.log(np.delete(vs, out)), rcond=None)[0]
        assert errors[out] == pytest.approx(np.log(vs[out]) - solution @ [1.0, *features[out]])
    monkeypatch.setattr("sys.argv", ["own_predictor.py", str(TUTORIAL), "5"])
    module.main()
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()] == [
        "content alone",
        "own",
        "path",
        "both",
    ]


@pytest.mark.slow
def test_a_crate_describes_its_files_and_gives_the_campaign_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, invoke: Callable[..., str]
) -> None:
    """Files have checksums; licence, authors and runs are named; a database made from the crate has the same bits."""
    database, configuration = Path(shutil.copy(TUTORIAL, tmp_path)), TUTORIAL.with_name("quick.toml")
    (tmp_path / "notes.txt").write_text("further file")
    out = tmp_path / "quick.zip"
    files = (tmp_path / "notes.txt", "--author", "Ada", "--author", "Émilie", "--licence", "CC0-1.0")
    module = example("ro_crate")

    def run_here(command: list[str], check: bool) -> None:
        assert command[1:3] == ["-m", "calcidem"]
        assert check
        invoke(*command[3:])

    monkeypatch.setattr(module, "subprocess", SimpleNamespace(run=run_here))  # in this process, which is there at once
    monkeypatch.setattr("sys.argv", ["ro_crate.py", *map(str, (database, configuration, out, *files))])
    module.main()
    with zipfile.ZipFile(out) as archive:
        archive.extractall(tmp_path / "crate")
    described = json.loads((tmp_path / "crate" / "ro-crate-metadata.json").read_text(encoding="utf-8"))
    entities = {entity["@id"]: entity for entity in described["@graph"]}
    root = entities["./"]
    names = {part["@id"] for part in root["hasPart"]}
    assert names == {"campaign.nc", configuration.name, "notes.txt"}
    for name in names:
        assert entities[name]["sha256"] == sha256((tmp_path / "crate" / name).read_bytes()).hexdigest()
    assert entities[root["license"]["@id"]]["name"] == "CC0-1.0"
    assert [entities[author["@id"]]["name"] for author in root["author"]] == ["Ada", "Émilie"]
    invoke("import", tmp_path / "crate" / "campaign.nc", "--db", tmp_path / "copy.db")
    with calcidem.open_campaign(database) as campaign, calcidem.open_campaign(tmp_path / "copy.db") as copy:
        assert copy.vs().to_numpy().tobytes() == campaign.vs().to_numpy().tobytes()
        actions = [entity for entity in entities.values() if entity["@type"] == "CreateAction"]
        versions = [entities[action["instrument"]["@id"]]["version"] for action in actions]
        assert versions == [run.versions["calcidem"] for _, run in campaign.runs()]
        assert entities[root["identifier"]["@id"]]["value"] == campaign.record.hash
    other = tmp_path / "other.toml"
    other.write_text(calcidem.preset_text("paper-as-printed"))
    monkeypatch.setattr("sys.argv", ["ro_crate.py", *map(str, (database, other, out))])
    with pytest.raises(SystemExit, match="is not the configuration of"):
        module.main()
