"""Configurations: what is right is read, what is wrong is refused as a whole before anything is done."""

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import CHECKOUT

from calcidem.app.cli.main import main
from calcidem.app.config import schema
from calcidem.app.config.examples import key_references
from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import load_configuration, read_configuration
from calcidem.app.config.schema import SECTIONS, CampaignPlan, Configuration, ConfigurationError, Excitation, RunOptions
from calcidem.dem.engine.fields import FieldError
from calcidem.dem.engine.scene import Cement
from calcidem.dem.sample.packing import PackingRule
from calcidem.dem.wave.experiment import WaveRule
from calcidem.storage.records import canonical_hash

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


# Physics version and file, and the hashes of its campaign and of its packing.
IDENTITIES = {
    (5, "examples/quick.toml"): (
        "b7bba99e6ee6d08082a48c956b03520f5b264f3911b0bf7c139595da98ba2a94",
        "4d59f8fd13535240870eec6cd01014ae1bf5f5536f64aab274543907a297c4c4",
    ),
    (5, "examples/paper.toml"): (
        "092611ac3c1af0a53ea2d0d25f60f61b0be499892742f02dee91fb9127bff7c2",
        "4d59f8fd13535240870eec6cd01014ae1bf5f5536f64aab274543907a297c4c4",
    ),
    (5, "examples/paper-as-printed.toml"): (
        "98d06b59dacc78fa5cc20ad05ce73578668e30f042415aa76f0339b506142f5e",
        "7464ace7b448cae813be393945282e617787c8343bc08ae9c0a6f2975b9fdff2",
    ),
    (5, "docs/tutorial/quick.toml"): (
        "b7bba99e6ee6d08082a48c956b03520f5b264f3911b0bf7c139595da98ba2a94",
        "4d59f8fd13535240870eec6cd01014ae1bf5f5536f64aab274543907a297c4c4",
    ),
}

# (text of the file, what the message must name: field and value, problem or cure)
WRONG = {
    "empty file": ("", ("the file is empty", "calcidem init")),
    "not TOML": ("[campaign]\nseeds = = 4\n", ("not TOML", "line 2")),
    "a word without quotes": ("[campaign]\nname = quick\n", ("not TOML", "line 2", '"..."')),
    "unknown section": ("[wavee]\n", ("wavee: unknown section", 'did you mean "wave"?')),
    "unknown key": ("[wave]\namplitud = 1.0\n", ("wave.amplitud: unknown key", 'did you mean "amplitude"?')),
    "strange key": ("[run]\nqqq = 1\n", ("run.qqq: unknown key", "there are lanes, store_sections")),
    "key of another section": (
        "[pattern]\nsand_density = 2650.0\n",
        ("pattern.sand_density: unknown key", "sand.density says it"),
    ),
    "value instead of section": ("wave = 3\n", ("wave = 3: is not a section", "write [wave]")),
    "no seeds": ("[campaign]\nseeds = 0\n", ("campaign.seeds = 0", "give a number n for the seeds 1 to n, or a list")),
    "empty seeds": (
        "[campaign]\nseeds = []\n",
        ("campaign.seeds = []", "give a number n for the seeds 1 to n, or a list"),
    ),
    "double seed": ("[campaign]\nseeds = [1, 2, 1]\n", ("campaign.seeds = [1, 2, 1]", "has every seed once")),
    "negative seed": ("[campaign]\nseeds = [-1]\n", ("campaign.seeds = [-1]", "seeds of 0 to 2^63 - 1")),
    "broken seed": ("[campaign]\nseeds = [1.5]\n", ("campaign.seeds = [1.5]", "a number n for the seeds 1 to n")),
    "negative content": ("[campaign]\ncontents = [-1.0]\n", ("campaign.contents = [-1.0]", "percentages of 0 to 100")),
    "double content": (
        "[campaign]\ncontents = [0.3, 0.30000000000000004]\n",
        ("campaign.contents = [0.3, 0.30000000000000004]", "has every content once"),
    ),
    "content in quotes": ('[campaign]\ncontents = ["5"]\n', ('campaign.contents = ["5"]', "a list of percentages")),
    "content without frequency": (
        "[campaign]\ncontents = [5.0, 12.0]\n",
        ("campaign.contents = [12.0]", "known from 0 to 9 %", "give wave.frequency"),
    ),
    "content not finite": (
        "[campaign]\ncontents = [nan]\n",
        ("campaign.contents = [nan]", "is not finite", "give 0, or a number of 1e-30"),
    ),
    "name with a slash": ('[campaign]\nname = "a/b"\n', ('campaign.name = "a/b"', "part of a file name")),
    "negative root": ("[campaign]\nroot_seed = -3\n", ("campaign.root_seed = -3", "give a whole number of 0 or more")),
    "negative width": ("[packing]\nwidth = -0.1\n", ("packing.width = -0.1", "give a positive number, in m")),
    "infinite height": ("[packing]\nheight = inf\n", ("packing.height = inf", "is not finite")),
    "three diameters": (
        "[packing]\ndiameter = [1e-3, 2e-3, 3e-3]\n",
        ("packing.diameter = [0.001, 0.002, 0.003]", "give (smallest, largest) in m"),
    ),
    "diameters in the wrong order": (
        "[packing]\ndiameter = [3e-3, 2e-3]\n",
        ("line 2: packing.diameter = [0.003, 0.002]", "give (smallest, largest)"),
    ),
    "disks too large for the box": (
        "[packing]\nwidth = 0.008\n",
        ("packing.diameter", "at least 4 disks must fit across the box"),
    ),
    "receiver narrower than a grain": (
        "[wave]\nreceiver_half_width = 1e-4\n",
        ("wave.receiver_half_width = 0.0001", "give at least the smallest radius, 0.00106 m"),
    ),
    "impossible porosity": ("[packing]\nporosity = 0.9\n", ("packing.porosity = 0.9", "between 0.1 and 0.35")),
    "negative packing seed": ("[packing]\nseed = -1\n", ("packing.seed = -1", "give a whole number of 0 or more")),
    "text for a number": (
        '[sand]\nfriction = "high"\n',
        ('line 2: sand.friction = "high"', "give a number of 0 or more"),
    ),
    "truth for a number": ("[sand]\nfriction = true\n", ("sand.friction = true", "give a number of 0 or more")),
    "negative modulus": (
        "[sand]\nshear_modulus = -1.0\n",
        ("sand.shear_modulus = -1.0", "give a positive number, in Pa"),
    ),
    "impossible Poisson ratio": ("[sand]\npoisson_ratio = 0.5\n", ("sand.poisson_ratio = 0.5", "(-1, 0.5)")),
    "no stiffness": (
        "[sand]\nwave_stiffness_factor = 0.0\n",
        ("sand.wave_stiffness_factor = 0.0", "give a positive factor"),
    ),
    "unknown installation": (
        '[cement]\ninstallation = "presrve"\n',
        ('cement.installation = "presrve"', 'give "preserve", "zero" or "pfc_absolute"'),
    ),
    "installation that the law cannot do": (
        '[cement]\ninstallation = "zero"\n[wave]\nlaw = "linear"\n',
        ('cement.installation = "zero"', 'choose wave.law = "auto" or "finite"'),
    ),
    "jump without a spring": (
        '[cement]\ninstallation = "pfc_absolute"\n[wave]\nlaw = "finite"\n',
        ('cement.installation = "pfc_absolute"', "give cement.linear_modulus in Pa"),
    ),
    "cement wider than a disk": (
        "[pattern]\nc_diameter = 2.5e-3\n",
        ("pattern.c_diameter = 0.0025", "packing.diameter[0] = 0.00212", "make it smaller"),
    ),
    "cluster larger than the box": (
        "[pattern]\ncluster_diameter = 0.2\n",
        ("pattern.cluster_diameter = 0.2", "larger than the box"),
    ),
    "patch of P larger than the box": (
        "[pattern]\np_patch_diameter = 0.2\n",
        ("pattern.p_patch_diameter = 0.2", "larger than the box"),
    ),
    "patch of P below zero": (
        "[pattern]\np_patch_diameter = -1e-3\n",
        ("p_patch_diameter = -0.001", "give 0 for single"),
    ),
    "stress that crushes the disks": (
        "[packing]\nstress = 1.0e8\n",
        ("packing.stress = 1e+08", "sand.shear_modulus = 6.5e+11", "packing.stress = 1.1e+06 Pa"),
    ),
    "friction below that of the preparation": (
        '[sand]\nfriction = 0.1\n[wave]\nlaw = "finite"\n',
        ("sand.friction = 0.1", "less than packing.friction_preparation = 0.2", "give as much or more"),
    ),
    "frequency that the steps do not resolve": (
        "[campaign]\ncontents = [5.0]\n[wave]\nfrequency = 4.5e5\nstep_fraction = 0.95\n",
        ("wave.frequency = 450000: at 5 %", "fewer than 20 time steps", "give at most 3e+05 Hz"),
    ),
    "frequency above the cut-off": (
        "[wave]\nfrequency = 5.0e5\n",
        ("wave.frequency = 500000", "lattice cut-off", "give at most half of that"),
    ),
    "endless record": ("[wave]\nfrequency = 1e-30\n", ("wave.step_fraction = 0.8", "records have", "more than 1e+08")),
    "endless steps": ("[wave]\nstep_fraction = 1e-12\n", ("wave.step_fraction = 1e-12", "time steps, more than 1e+08")),
    "negative frequency": ("[wave]\nfrequency = -1.0\n", ("wave.frequency = -1.0", "positive frequency in Hz")),
    "frequency in words": (
        '[wave]\nfrequency = "8 kHz"\n',
        ('wave.frequency = "8 kHz"', "give a positive frequency in Hz"),
    ),
    "uneven table of frequencies": (
        "[wave.frequency]\ncontent = [0.0, 9.0]\nfrequency = [4e3]\n",
        ("wave.frequency.frequency = [4000.0]", "one positive frequency in Hz for each of the 2 contents"),
    ),
    "half a table of frequencies": (
        "[wave.frequency]\ncontent = [0.0, 9.0]\n",
        ("wave.frequency.frequency: is missing", "add it"),
    ),
    "a table with another key": (
        "[wave.frequency]\ncontent = [0.0, 9.0]\nfrequency = [4e3, 8e3]\nunit = 1\n",
        ("line 4: wave.frequency.unit: is unknown", "there are content, frequency"),
    ),
    "a table with one wrong number": (
        "[wave.frequency]\ncontent = [0.0, 9.0]\nfrequency = [4e3, true]\n",
        ("wave.frequency.frequency = [4000.0, true]: entry 2: give a list of positive frequencies",),
    ),
    "a table that is not rising": (
        "[wave.frequency]\ncontent = [9.0, 0.0]\nfrequency = [4e3, 8e3]\n",
        ("wave.frequency.content = [9.0, 0.0]", "give increasing contents in percent"),
    ),
    "a date": (
        "[campaign]\nseeds = [2001-01-01]\n",
        ("campaign.seeds = [2001-01-01]", "give a number n for the seeds 1 to n"),
    ),
    "step above the limit": (
        "[wave]\nstep_fraction = 1.2\n",
        ("wave.step_fraction = 1.2", "above 1 the scheme is unstable", "give 0.05 to 0.95"),
    ),
    "transmitter larger than the sample": (
        "[wave]\ntransmitter_half_width = 0.15\n",
        ("wave.transmitter_half_width = 0.15", "less than half of packing.height, 0.15 m"),
    ),
    "boundary larger than the sample": (
        "[wave]\nboundary_thickness = 0.2\n",
        ("wave.boundary_thickness = 0.2", "less than half of packing.height"),
    ),
    "listening to nothing": (
        "[wave]\nlistening_depth = 1e-3\n",
        ("wave.listening_depth = 0.001", "more than the largest diameter"),
    ),
    "stations are no key": ("[wave]\nstations = 9\n", ("wave.stations: unknown key",)),
    "waiting for ever": ("[wave]\nslowest = 0.0\n", ("wave.slowest = 0.0", "give a positive number")),
    "unknown law": ('[wave]\nlaw = "big"\n', ('wave.law = "big"', 'give "auto", "linear" or "finite"')),
    "amplitude of zero": ("[wave]\namplitude = 0.0\n", ("wave.amplitude = 0.0", "give a positive number")),
    "unknown method": ('[pick]\nmethod = "eye"\n', ('pick.method = "eye"', '"peak", "first_arrival" or "cross_corr')),
    "error out of reach": ("[pick]\nlargest_error = 1.5\n", ("pick.largest_error = 1.5", "give ")),
    "odd lanes": ("[run]\nlanes = 7\n", ("run.lanes = 7", "give 1, 2, 4, 8, 16 or 32")),
    "truth as a number": ("[run]\nstore_sections = 1\n", ("run.store_sections = 1", "give true or false")),
    "no time": ("[run]\ntime_limit = 0.0\n", ("run.time_limit = 0.0", "give seconds above 0")),
    "database is a folder": ('[run]\ndatabase = "."\n', ('run.database = "."', "is a folder", "give a file name")),
    "database nowhere": (
        '[run]\ndatabase = "/proc/none/a.db"\n',
        ('run.database = "/proc/none/a.db"', "its folder cannot be written"),
    ),
    "database below a file": (
        '[run]\ndatabase = "wrong.toml/a.db"\n',
        ('run.database = "wrong.toml/a.db"', "its folder cannot be written", "in which you may write"),
    ),
    "database of no kind": (
        '[run]\ndatabase = "://host/a"\n',
        ('run.database = "://host/a"', "dialect+driver://user@host/database"),
    ),
    "output is a file": ('[run]\noutput = "wrong.toml"\n', ('run.output = "wrong.toml"', "is a file")),
    "output nowhere": ('[run]\noutput = "/proc/none"\n', ('run.output = "/proc/none"', "nothing can be written")),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_configuration_is_refused_before_any_work(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command ends with 2, the message names field, value and cure, and no file is made."""
    text, expected = WRONG[case]
    (tmp_path / "wrong.toml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CALCIDEM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("sys.argv", ["calcidem", "run", "wrong.toml"])
    with pytest.raises(SystemExit) as ended:
        main()
    message = capsys.readouterr().err
    assert ended.value.code == 2
    assert message.startswith("Error: wrong.toml: ")
    for part in expected:
        assert part in message
    assert [path.name for path in tmp_path.iterdir()] == ["wrong.toml"]


def test_a_missing_file_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A configuration that does not exist gives exit code 2 and says how to get one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["calcidem", "run"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "calcidem.toml: 1 problem" in (message := capsys.readouterr().err)
    assert "the file does not exist" in message
    assert "calcidem init" in message


def test_all_problems_are_said_at_once() -> None:
    """Several wrong values in one section and in several are all named, and nothing is blamed for a neighbour."""
    document = {
        "campaign": {"seeds": 0, "contents": [-1.0]},
        "packing": {"widht": 0.1, "porosity": 0.9, "damping": 2.0},
        "pattern": {"c_diameter": -1.0},
    }
    with pytest.raises(ConfigurationError) as refused:
        read_configuration(document)
    blamed = {field for problem in refused.value.problems for field in problem.fields}
    assert blamed == {
        "campaign.seeds",
        "campaign.contents",
        "packing.widht",
        "packing.porosity",
        "packing.damping",
        "pattern.c_diameter",
    }


def test_a_rule_of_several_fields_is_told_beside_what_is_wrong_with_others() -> None:
    """Fields that a class refuses together are all blamed, and so is the one beside them that is wrong by itself."""
    with pytest.raises(ConfigurationError) as refused:
        read_configuration({"pick": {"smoothing": 2.0}, "packing": {"width": 0.008, "damping": 2.0}})
    assert {problem.fields for problem in refused.value.problems} == {
        ("pick.smoothing",),
        ("packing.damping",),
        ("packing.diameter", "packing.width", "packing.height"),
    }


def test_a_class_refuses_in_the_words_of_the_reference() -> None:
    """What the page says of a key is what the reader says of a wrong value, and the class that is made in Python."""
    accepted = next(key.accepted for key in key_references() if key.name == "porosity")
    for make in (lambda: read_configuration({"packing": {"porosity": 0.9}}), lambda: PackingRule(porosity=0.9)):
        with pytest.raises(ValueError, match=re.escape(f"porosity = 0.9: give {accepted}")):
            make()


def test_one_checker_says_all_that_is_wrong_with_a_class(tmp_path: Path) -> None:
    """A class made in Python refuses all wrong values in the words that a file gets, with section and line there."""
    table = {"content": [0.0, 9.0], "frequency": [4e3, -1.0], "unit": 1}
    with pytest.raises(FieldError) as in_python:
        Excitation(table)
    text = "# A table in one line.\n\n[wave]\n'frequency' = { content = [0, 9], frequency = [4e3, -1.0], unit = 1 }\n"
    (tmp_path / "wrong.toml").write_text(text)
    with pytest.raises(ConfigurationError) as in_file:
        load_configuration(tmp_path / "wrong.toml")
    assert [f"line 4: wave.{line}" for line in str(in_python.value).split("\n")] == [
        problem.message for problem in in_file.value.problems
    ]
    with pytest.raises(
        FieldError, match=r"^amplitude = -1: give a positive.*\ndamping = 2: give a factor in \[0, 0.7\]"
    ):
        WaveRule(amplitude=-1, damping=2)  # in the order of the fields


def test_arrays_and_numbers_of_numpy_are_taken() -> None:
    """Lists and arrays become tuples, numbers those of Python; an infinite strength never breaks, in Python alone."""
    plan = CampaignPlan(seeds=np.int64(3), contents=np.array([0.0, 5.0]))  # type: ignore[arg-type]  # not declared
    assert plan == CampaignPlan(seeds=3, contents=(0.0, 5.0))
    assert Cement(tensile_strength=np.inf).tensile_strength == np.inf
    with pytest.raises(ConfigurationError, match="tensile_strength = inf: is not finite"):
        read_configuration({"cement": {"tensile_strength": np.inf}})


@given(st.floats(min_value=1e-30, max_value=1e30))
def test_numbers_are_read_to_the_last_bit(amplitude: float) -> None:
    """No digit of a number is lost on its way into the class that uses it."""
    assert read_configuration({"wave": {"amplitude": amplitude}}).wave.amplitude == amplitude


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_good(name: str, tmp_path: Path) -> None:
    """The example configurations are read without complaint and are the files in examples."""
    path = tmp_path / "preset.toml"
    path.write_text(preset_text(name), encoding="utf-8")
    configuration = load_configuration(path)
    assert configuration.campaign.name == name
    seeds, contents = (4, 6) if name == "quick" else (116, 17)
    assert len(configuration.campaign.seed_numbers) == seeds
    assert len(configuration.campaign.contents) == contents


def test_examples_are_the_presets() -> None:
    """The presets are among the files in examples."""
    examples = {path.stem: path.read_text(encoding="utf-8") for path in (CHECKOUT / "examples").glob("*.toml")}
    assert {name: examples[name] for name in PRESETS} == {name: preset_text(name) for name in PRESETS}


@pytest.mark.parametrize(("version", "name"), IDENTITIES)
def test_campaigns_keep_their_identity(version: int, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The hashes of campaign and packing are those with which databases and cached packings were made."""
    assert max(IDENTITIES)[0] == schema.PHYSICS_VERSION
    monkeypatch.setattr(schema, "PHYSICS_VERSION", version)
    configuration = load_configuration(CHECKOUT / name)
    assert (configuration.hash, configuration.packing_hash) == IDENTITIES[version, name]


def test_a_key_at_its_default_is_not_hashed() -> None:
    """The hash is of what departs from the defaults, so that a new key leaves the identity of all campaigns alone."""
    version = {"physics_version": schema.PHYSICS_VERSION}
    assert Configuration().hash == canonical_hash(version)
    written = {"slowest": Configuration().wave.slowest, "damping": Configuration().wave.damping}
    assert read_configuration({"wave": written}).hash == canonical_hash(version)
    departing = read_configuration({"wave": {"slowest": 80.0}, "run": {"lanes": 4}})
    assert departing.hash == canonical_hash(version | {"wave": {"slowest": 80.0}})
    assert departing.physics.keys() > version.keys()
    assert departing.physics["wave"]["damping"] == Configuration().wave.damping
    assert Configuration.from_physics(departing.physics).wave == departing.wave


def other(value: Any) -> Any:  # noqa: ANN401 - any field of a configuration
    """Give another value of the same type."""
    if isinstance(value, tuple):
        return tuple(other(item) for item in value) or ("something",)
    if value is None:
        return 3.0e-6
    return {bool: lambda: not value, str: lambda: value + "x"}.get(type(value), lambda: value * 2 + 1)()


PHYSICAL = [
    (attribute, field.name)
    for section, types in SECTIONS.items()
    if section not in {"campaign", "run"}
    for attribute, kind in types.items()
    for field in fields(kind)
    if (attribute, field.name) != ("pattern", "sand_density")
]


@pytest.mark.parametrize(("attribute", "name"), PHYSICAL)
def test_whatever_changes_the_physics_changes_the_hash(attribute: str, name: str) -> None:
    """Every key of the physical sections is part of the campaign's hash."""
    configuration = Configuration()
    part: DataclassInstance = getattr(configuration, attribute)
    changed = object.__new__(type(part))
    for field in fields(part):  # past the checks: most of these values are nonsense
        value = getattr(part, field.name)
        object.__setattr__(changed, field.name, other(value) if field.name == name else value)
    if isinstance(changed, Excitation):
        changed = Excitation(8.0e3)
    assert replace(configuration, **{attribute: changed}).hash != configuration.hash


def test_root_seed_is_physical_but_the_plan_is_not() -> None:
    """Another root seed is another campaign; name, seeds, contents and run options are not."""
    configuration = Configuration()
    planned = CampaignPlan(name="other", seeds=(7,), contents=(1.0,))
    assert replace(configuration, campaign=planned, run=RunOptions(lanes=4)).hash == configuration.hash
    assert replace(configuration, campaign=CampaignPlan(root_seed=1)).hash != configuration.hash


@given(st.integers(min_value=1, max_value=500))
def test_a_number_of_seeds_stands_for_its_list(count: int) -> None:
    """`seeds = n` and the list 1 to n are the same plan."""
    listed = CampaignPlan(seeds=tuple(range(1, count + 1)))
    assert CampaignPlan(seeds=count).seed_numbers == listed.seed_numbers


@given(st.integers(min_value=1, max_value=10**6))
def test_whole_numbers_are_the_same_as_their_decimals(amplitude: int) -> None:
    """`5` and `5.0` in a file give the same hash."""
    hashes = {read_configuration({"wave": {"amplitude": value}}).hash for value in (amplitude, float(amplitude))}
    assert len(hashes) == 1


def test_the_friction_of_the_sand_does_not_change_the_packing() -> None:
    """The packing is made with its own friction, so it is shared by campaigns that differ in the sand's."""
    smooth, rough = (read_configuration({"sand": {"friction": value}}) for value in (0.3, 0.9))
    assert smooth.packing_hash == rough.packing_hash
    assert smooth.hash != rough.hash


def test_frequencies_of_the_paper_are_the_default() -> None:
    """Without a frequency, Table 2 of the paper is used and becomes part of the hash."""
    table = Configuration().excitation.table
    assert (table.at(0.0), table.at(5.0), table.at(4.5)) == (4.0e3, 15.0e3, 12.5e3)
    written = {"content": list(table.content), "frequency": list(table.frequency)}
    assert read_configuration({"wave": {"frequency": written}}).hash == Configuration().hash


def test_contents_are_those_of_cells() -> None:
    """To 1e-9 percent: otherwise a cell of 1/3 % would be planned and never found."""
    plan = CampaignPlan(contents=(1 / 3, 0.1 + 0.2, 5.0))
    assert plan.contents == (0.333333333, 0.3, 5.0)


@pytest.mark.parametrize(
    ("database", "exported"),
    [("sand.db", "sand.nc"), ("sand.sqlite3", "sand.nc"), ("sand.seeds1", "sand.seeds1.nc"), ("sand", "sand.nc")],
)
def test_no_two_databases_have_one_export(database: str, exported: str) -> None:
    """Only an ending for databases gives way to that of the file."""
    configuration = Configuration(run=RunOptions(database=database))
    assert configuration.netcdf.name == exported
