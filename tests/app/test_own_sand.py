"""A sand of one's own: `calcidem init --grain-size` writes a configuration whose cells have velocities."""

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calcidem.app.campaign.packing import new_packing
from calcidem.app.config.checks import check_against_packing
from calcidem.app.config.examples import OwnDisks, OwnSand, parse_quantity, read_grading, read_mineral, uniform_limits
from calcidem.app.config.reader import read_configuration
from calcidem.app.config.schema import Configuration, ConfigurationError, Excitation
from calcidem.dem.sample.compaction import packing_from_csv, write_disks_csv
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure
from calcidem.input_file import InputFileError


def part_with_velocity(own: OwnSand, seeds: int) -> float:
    """Part of the cells that have a velocity, and check it without cement: the file expects it."""
    configuration = read_configuration(tomllib.loads(own.text()))
    packing = new_packing(configuration)
    check_against_packing(configuration, packing)
    experiment = configuration.experiment(packing).with_wave(precision="float32")  # with 16 lanes: the kernel of quick
    contents = configuration.campaign.contents
    found = [measure(experiment, content, range(1, seeds + 1), lanes=16) for content in contents]
    assert found[0][0].vs == pytest.approx(own.velocity, rel=0.25)  # packings of 1,500 disks differ by some percent
    assert own.overlap == pytest.approx(packing.report.mean_overlap / packing.radius.mean(), rel=0.3)
    return sum(cell.vs is not None for cells in found for cell in cells) / (seeds * len(found))


@pytest.mark.full  # two kernels of presets, a packing and some samples each
@pytest.mark.parametrize(
    "own",
    [
        ("0.1mm", "1MPa", "carbonate"),
        ("5mm", "20kPa", "quartz"),
        ("0.1mm,0.3mm,0.9mm", "1bar", "glass"),
    ],
)
def test_a_written_configuration_needs_no_edit(own: tuple[str, str, str]) -> None:
    """Sands unlike the paper's have the velocity that the file expects, also those of many sizes."""
    assert part_with_velocity(OwnSand.of_words(*own, "0", Path()), seeds=2) == 1.0


def test_a_written_configuration_is_that_of_the_grain() -> None:
    """Lengths and modulus follow the grain, stress over modulus the overlap; the velocity depends on stress alone."""
    fine, coarse = (OwnSand(size, 100e3, "quartz", (0.0, 2.0)) for size in (0.3e-3, 3e-3))
    written = [read_configuration(tomllib.loads(own.text())) for own in (fine, coarse)]
    lengths = [(c.packing.width, c.pattern.c_diameter, c.wave.receiver_half_width) for c in written]
    np.testing.assert_allclose(lengths[1], 10.0 * np.array(lengths[0]), rtol=1e-3)  # four digits are written
    assert written[1].sand.shear_modulus == pytest.approx(written[0].sand.shear_modulus / 10.0, rel=1e-3)
    assert written[0].cement == written[1].cement
    assert (fine.overlap, fine.velocity) == pytest.approx((coarse.overlap, coarse.velocity))
    assert fine.overlap == pytest.approx((3.0 * 2.0**0.5 * 0.92 * 100e3 / 44e9) ** (2 / 3))
    assert OwnSand(1e-3, 1e5, "calcite", (0.0,)).sand == OwnSand(1e-3, 1e5, "carbonate", (0.0,)).sand
    higher = OwnSand(0.3e-3, 800e3, "quartz", (0.0,))
    assert higher.overlap == pytest.approx(4.0 * fine.overlap)
    assert higher.velocity == pytest.approx(2.0**0.5 * fine.velocity)


def test_own_disks_are_written_with_lengths_of_their_box(tmp_path: Path) -> None:
    """Box and grain are those of the file; the bands fit the height that loose disks have once they are compressed."""
    place = np.stack(np.meshgrid(np.arange(0.5, 36.0), np.arange(0.5, 60.0)), axis=-1).reshape(-1, 2)
    radius = np.resize([0.3, 0.4, 0.5], len(place))
    write_disks_csv(*(1e-3 * place).T, 1e-3 * radius, tmp_path / "disks.csv")
    disks = OwnDisks.read(tmp_path / "disks.csv", tmp_path / "elsewhere")
    assert (disks.file, disks.count) == ("../disks.csv", 2160)
    assert disks.width == pytest.approx(36e-3)
    assert disks.height == pytest.approx(60e-3 * np.pi * np.mean(radius**2) / 0.8, rel=1e-3)
    own = OwnSand(disks.diameters[1], 100e3, "quartz", (0.0, 2.0), disks)
    (tmp_path / "elsewhere").mkdir()
    written = read_configuration(tomllib.loads(own.text()), folder=tmp_path / "elsewhere")
    assert written.packing.diameter == pytest.approx((0.6e-3, 1e-3))
    assert written.wave.transmitter_half_width == pytest.approx(0.45 * disks.height, rel=1e-3)


def test_grain_sizes_and_stresses_have_units() -> None:
    """With or without a blank; what has no unit, another one, or is impossible is refused with an example."""
    sizes = ("0.3mm", " 300 um", "300 \u00b5m", "300\u03bcm", "0.3 MM")
    assert [parse_quantity("grain size", text) for text in sizes] == [0.3e-3] * 5
    assert [parse_quantity("stress", text) for text in ("1e5 Pa", "0.1MPa", "1bar", "100 kpa")] == [1e5] * 4
    for quantity, text in (
        *(("grain size", text) for text in ("3", "0mm", "-1mm", "nanmm", "1e99m", "1..mm", "3 kPa", "")),
        *(("stress", text) for text in ("100", "0kPa", "1psi")),
    ):
        with pytest.raises(ValueError, match="such as"):
            parse_quantity(quantity, text)


def test_a_mineral_is_a_name_or_three_numbers() -> None:
    """All that depends on the mineral follows: modulus, bonds and overlap."""
    assert read_mineral("44GPa, 0.08, 2.65 g/cm3") == read_mineral("quartz") == read_mineral("4.4e10Pa,0.08,2650")
    own, quartz = (OwnSand(1e-3, 1e5, text, (0.0,)) for text in ("44GPa,0.08,2650kg/m3", "quartz"))
    assert (own.bond_modulus, own.overlap) == (quartz.bond_modulus, quartz.overlap)
    written = read_configuration(tomllib.loads(own.text()))
    assert written.physics == read_configuration(tomllib.loads(quartz.text())).physics
    assert written.campaign.name == "own-mineral-1mm-100kPa"
    assert OwnSand(1e-3, 1e5, "glass", (0.0,)).sand.density == 2500.0
    for text in ("gold", "44,0.08,2650", "44GPa,0.08", "44GPa,0.7,2650", "44GPa,0.08,2.65", "44GPa,0.08kg,2650"):
        with pytest.raises(ValueError, match=r"such as 30GPa,0\.2,2500kg/m3"):
            read_mineral(text)


@pytest.mark.parametrize(("smallest", "largest"), [(1.0, 1.0001), (1.0, 1.5), (0.2, 0.49)])
def test_uniform_diameters_have_the_grading_that_they_are_made_from(smallest: float, largest: float) -> None:
    """By mass, which in the plane is area: sampled diameters give d10, d50 and d90, and these the limits again."""
    diameters = np.linspace(smallest, largest, 200_001)
    area = np.cumsum(diameters**2) / np.sum(diameters**2)
    d10, d50, d90 = (float(np.interp(share, area, diameters)) for share in (0.1, 0.5, 0.9))
    assert uniform_limits(d10, d50, d90) == pytest.approx((smallest, largest), rel=1e-4)


def test_a_wide_grading_keeps_its_median() -> None:
    """Of a sand with more sizes than a packing holds, half of the mass is below d50; the file has both gradings."""
    smallest, largest = uniform_limits(0.1, 0.3, 1.0)
    assert largest == pytest.approx(2.5 * smallest)
    assert 0.5 * (smallest**3 + largest**3) == pytest.approx(0.3**3)
    own = OwnSand.of_words("100um,0.3mm,1mm", "100kPa", "quartz", "0,2", Path())
    assert own.grain_size == pytest.approx(0.5e-3 * (smallest + largest), rel=2e-3)
    written = read_configuration(tomllib.loads(own.text()))
    assert written.packing.diameter == pytest.approx((1e-3 * smallest, 1e-3 * largest), rel=5e-3)
    assert "by mass, 0.1, 0.3, 1 mm given" in own.text()
    with pytest.raises(ConfigurationError, match="give the mean diameter, or increasing d10, d50 and d90"):
        OwnSand.of_words("0.3mm,0.2mm,0.1mm", "100kPa", "quartz", "0,2", Path())


GRADING = "Sieve;Percent finer\n(mm);(%)\n1,0;100\n0,5;90\n0,1;10\n0,063;0\n"


def test_a_grading_is_read_from_a_table(tmp_path: Path, invoke: Callable[..., str]) -> None:
    """In any order and unit; between sieves linear in the logarithm of the size, and `init` takes it."""
    (tmp_path / "sizes.csv").write_text(GRADING, encoding="utf-8")
    grading = read_grading(tmp_path / "sizes.csv")
    assert grading == pytest.approx((0.1e-3, np.sqrt(0.05) * 1e-3, 0.5e-3))
    german = "Korngröße (mm);Siebdurchgang (%)\n1,0;100\n0,5;90\n0,1;10\n"
    (tmp_path / "german.csv").write_text(german, encoding="utf-8")
    assert read_grading(tmp_path / "german.csv") == pytest.approx(grading)
    told = invoke("init", tmp_path / "a.toml", "--grading", tmp_path / "sizes.csv", "--mineral", "glass")
    assert "d10, d50, d90" in told
    assert "disks in all" in told
    assert "amplitude = " in told
    written = read_configuration(tomllib.loads((tmp_path / "a.toml").read_text(encoding="utf-8")))
    assert written.packing.diameter == pytest.approx(uniform_limits(*grading), rel=5e-3)
    (tmp_path / "large.csv").write_text("size (m),finer\n2,0\n3,50\n4,100\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="--grading"):
        invoke("init", tmp_path / "b.toml", "--grading", tmp_path / "large.csv")
    both = ("--grading", tmp_path / "sizes.csv", "--grain-size", "1mm")
    assert "leave it out: the grading has it" in invoke("init", tmp_path / "b.toml", *both, exit_code=2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("size,finer\n0.1,10\n0.5,90\n", "row 2 = 0.1,10 and 1 more row: give a size with its unit"),
        ("size (mm),retained\n0.1,10\n0.5,90\n", "column finer: is missing; there are size (mm), retained"),
        ("size (mm),finer\n0.1,20\n0.5,90\n", "finer = 20 to 90: give percent finer that grows"),
        ("size (mm),finer\n0.1,0\n0.2,90\n0.5,60\n", "finer = 0 to 60"),
        ("size (mm),finer\n0.1,0.1\n0.5,0.9\n", "finer = 0.1 to 0.9"),
        ("size (mm),finer\n0.1,0\n0.5,190\n", "row 3 = 0.5,190"),
        ("size (mm),finer\n", "rows = 0"),
    ],
)
def test_a_grading_that_is_none_is_refused(text: str, words: str, tmp_path: Path) -> None:
    """Place, value and cure."""
    (tmp_path / "sizes.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        read_grading(tmp_path / "sizes.csv")
    assert words in str(caught.value)


def test_a_grading_in_units_of_another_quantity_is_refused(tmp_path: Path) -> None:
    """With the column and its unit."""
    (tmp_path / "sizes.csv").write_text("size (mm),finer (mm)\n0.1,10\n0.5,90\n", encoding="utf-8")
    with pytest.raises(InputFileError, match=r"column 'finer \(mm\)': its unit 'mm' is not one of this quantity"):
        read_grading(tmp_path / "sizes.csv")


def test_sands_that_cannot_be_computed_are_refused() -> None:
    """A stress that crushes grains of quartz, and more calcite than there are pores."""
    with pytest.raises(ConfigurationError, match=r"packing\.stress = 9e\+08: presses disks"):
        OwnSand(1e-3, 900e6, "quartz", (0.0,)).text()
    with pytest.raises(ConfigurationError, match="contents = 60: calcite fills the pores at 23"):
        OwnSand(1e-3, 100e3, "quartz", (0.0, 60.0)).text()


@pytest.mark.full
@pytest.mark.parametrize("mineral", ["quartz", "carbonate"])
@pytest.mark.parametrize("stress", [20e3, 100e3, 1e6])
@pytest.mark.parametrize("grain_size", [0.1e-3, 0.3e-3, 1e-3, 5e-3])
def test_written_configurations_need_no_edit(grain_size: float, stress: float, mineral: str) -> None:
    """Of fine and coarse sands under low and high stress at least nine cells of ten have a velocity."""
    assert part_with_velocity(OwnSand(grain_size, stress, mineral, (0.0, 1.0, 2.0, 4.0)), seeds=4) >= 0.9


def magnified(configuration: Configuration, factor: float) -> Configuration:
    """All lengths multiplied by a factor, the grains' modulus and the frequency divided by it."""
    rule, wave, sand = configuration.packing, configuration.wave, configuration.sand
    pattern, frequency = configuration.pattern, configuration.excitation.frequency
    assert isinstance(frequency, float)
    sizes = (factor * rule.diameter[0], factor * rule.diameter[1])
    bands = ("transmitter_half_width", "receiver_half_width", "boundary_thickness", "listening_depth")
    widths = ("p_diameter", "c_diameter", "cluster_diameter")
    return replace(
        configuration,
        packing=replace(rule, width=factor * rule.width, height=factor * rule.height, diameter=sizes),
        sand=replace(sand, shear_modulus=sand.shear_modulus / factor),
        pattern=replace(pattern, **{name: factor * getattr(pattern, name) for name in widths}),
        wave=replace(wave, **{name: factor * getattr(wave, name) for name in bands}),
        excitation=Excitation(frequency / factor),
    )


def velocities(configuration: Configuration, packing: Packing) -> list[float | None]:
    """Velocities of samples with little and with more cement, most of which are read."""
    experiment = configuration.experiment(packing)
    found = [cell.vs for content in (0.66, 2.0) for cell in measure(experiment, content, (1, 2))]
    assert sum(vs is not None for vs in found) >= 3
    return found


@pytest.fixture(scope="module")
def small_sand(small_configuration: Configuration) -> Configuration:
    """Give the small campaign with gentle waves of at least 20 steps, read however uncertain."""
    pick, wave = replace(small_configuration.pick, largest_error=1.0), replace(small_configuration.wave, amplitude=1e-4)
    return replace(small_configuration, wave=wave, excitation=Excitation(24e3), pick=pick)


@pytest.mark.slow
def test_a_sand_four_times_as_large_has_the_same_velocities_to_the_bit(
    small_sand: Configuration, small_packing: Packing, tmp_path: Path
) -> None:
    """Disks of a file: lengths times 4, G / 4, f / 4, the rest the same. Each quantity changes by a power of two.

    Overlaps grow by 4, so Hertz's coefficient with sqrt(R) halves, and forces grow by 4, masses by 16, times by 4,
    moments by 16 and moments of inertia by 256; stiffnesses and speeds stay. Powers of two round nothing.
    """
    found = []
    for factor in (1.0, 4.0):
        sand, file = magnified(small_sand, factor), tmp_path / f"{factor}.csv"
        write_disks_csv(*(factor * values for values in (small_packing.x, small_packing.y, small_packing.radius)), file)
        found.append(velocities(sand, packing_from_csv(file, sand.sand, sand.packing)))
    assert found[0] == found[1]


@pytest.mark.full
@pytest.mark.parametrize("factor", [0.1, 3.0])
@pytest.mark.parametrize(("damping", "accuracy"), [(0.0, 1e-6), (0.3, 1e-5)])
def test_a_sand_of_any_size_has_the_same_velocities(
    small_sand: Configuration, small_packing: Packing, factor: float, damping: float, accuracy: float
) -> None:
    """Other factors round differently. Local damping amplifies that a little, since it takes the sign of a velocity.

    The packing is scaled at rest: disks that slide while they come to rest may find other places.
    """
    report = replace(small_packing.report, mean_overlap=factor * small_packing.report.mean_overlap)
    preload = replace(small_packing.preload, shear=factor * small_packing.preload.shear)
    lengths = {name: factor * getattr(small_packing, name) for name in ("x", "y", "radius", "width", "height")}
    large = replace(small_packing, preload=preload, report=report, **lengths)
    own = replace(small_sand, wave=replace(small_sand.wave, damping=damping, boundary_damping=damping))
    wanted = [None if vs is None else pytest.approx(vs, rel=accuracy) for vs in velocities(own, small_packing)]
    assert velocities(magnified(own, factor), large) == wanted


def test_fractions_for_percent_are_questioned(tmp_path: Path, invoke: Callable[..., str]) -> None:
    """A hundredth of a percent of calcite is hardly meant."""
    words = ("--grain-size", "0.3mm", "--contents")
    assert "is 0.03 % meant, not a fraction?" in invoke("init", str(tmp_path / "a.toml"), *words, "0,0.01,0.03")
    assert "not a fraction" not in invoke("init", str(tmp_path / "b.toml"), *words, "0,1,3")


@pytest.mark.parametrize("words", [("0.3mm", "--contents", ""), ("0.3mm", "--mineral", ""), ("",)])
def test_empty_words_are_no_defaults(words: tuple[str, ...], tmp_path: Path, invoke: Callable[..., str]) -> None:
    """A variable of a shell that is empty is not silently replaced."""
    with pytest.raises(ConfigurationError, match=r"--contents : give|--mineral : |--grain-size: "):
        invoke("init", tmp_path / "a.toml", "--grain-size", *words)


def test_a_refused_sand_leaves_no_job(
    tmp_path: Path, invoke: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The Slurm job is written after all options are accepted."""
    monkeypatch.chdir(tmp_path)
    invoke("init", "own.toml", "--contents", "1", "--slurm", exit_code=2)
    assert not list(tmp_path.iterdir())
