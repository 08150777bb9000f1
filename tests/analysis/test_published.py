import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from calcidem.analysis.measured import published_study
from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import read_configuration

sys.path.append(str(Path(__file__).parents[2] / "docs" / "reproduction"))

from published_check import StatementCheck, check_study, check_verdicts


def finding(place: str, words: str) -> StatementCheck:
    """Pick the one finding at a place whose printed side has certain words."""
    (found,) = [item for item in check_study() if item.place == place and words in item.printed]
    return found


def test_the_tables_are_whole() -> None:
    """There are 17 contents from 0 to 9 %, 16 of them with velocities, and 116 seeds make 1972 samples."""
    study = published_study()
    assert len(study.frequencies) == 17
    assert list(study.frequencies) == sorted(study.frequencies)
    assert study.frequencies.keys() - dict(study.velocities).keys() == {0.0}
    assert study.seeds * len(study.frequencies) == study.samples


def test_entries_are_the_printed_ones() -> None:
    """Spot checks of all four tables against the paper."""
    study = published_study()
    assert study.parameters["bond_effective_modulus"] == 8e10
    assert study.frequencies[5.0] == 15e3
    row = dict(study.velocities)[5.0]
    assert (row.mean, row.standard_deviation, row.skewness, row.kurtosis) == (1211.31, 260.74, 0.36, 2.60)
    assert [law.weights.bond for law in study.laws] == [0.328, 0.83]


@pytest.mark.parametrize("preset", PRESETS)
def test_the_presets_are_of_the_published_sand(preset: str) -> None:
    """They stand beside the paper whatever their stress; the same with another modulus of the grains does not."""
    configuration = read_configuration(tomllib.loads(preset_text(preset)))
    assert published_study().has_sand_of(configuration.physics)
    assert not published_study().has_sand_of(
        replace(configuration, sand=replace(configuration.sand, shear_modulus=29e9)).physics
    )


def test_six_verdicts_disagree_with_their_moments() -> None:
    """The moments at 0.23, 0.34, 0.45, 0.55, 4 and 9 % reject normality, and the table marks them normal."""
    wrong = [check for check in check_verdicts() if not check.agrees]
    assert [check.content for check in wrong] == [0.23, 0.34, 0.45, 0.55, 4.0, 9.0]
    assert all(check.printed_normal for check in wrong)


def test_the_small_sample_p_rejects_the_same_contents() -> None:
    """Allowing for n = 116 by simulation changes none of the six verdicts."""
    wrong = [check for check in check_verdicts() if check.printed_normal and check.p_small_sample < 0.05]
    assert [check.content for check in wrong] == [0.23, 0.34, 0.45, 0.55, 4.0, 9.0]


@pytest.mark.parametrize("stage", ["I", "II", "III", "IV"])
def test_rates_are_end_point_slopes(stage: str) -> None:
    """The printed rates are the slopes between 0.11 and 0.66, 1.24 and 3.17, 4 and 6, 7 and 9 %."""
    assert finding(f"Section 3.2.1, stage {stage}", "m/s per percent").agrees


def test_rates_do_not_belong_to_the_printed_borders() -> None:
    """Between the borders that the text draws, only the rate of the first stage comes out."""
    places = [f"Section 3.2.1, stage {stage}, its own borders" for stage in ("I", "II", "III", "IV")]
    assert [finding(place, "rate").agrees for place in places] == [True, False, False, False]


def test_the_texts_claims_are_checked() -> None:
    """Three claims of the text about rates, skewness and kurtosis disagree with the table, one agrees."""
    assert not finding("Section 3.2.1, stage III", "highest").agrees
    assert "-0.13 at 0.11 %" in finding("Section 3.2.1, stage I", "skewness").computed
    assert "5.68 at 2.55 %" in finding("Section 3.2.1, stage II", "kurtosis").computed
    assert finding("Section 3.2.1, stage IV", "skewness").agrees


def test_the_variance_is_a_standard_deviation() -> None:
    """What the text calls variance is the range of the table's standard deviations."""
    found = finding("Section 3.2.1, stage I", "variance")
    assert not found.agrees
    assert "9.76 to 35.49 m/s" in found.computed


@pytest.mark.parametrize("law", ["physical meaning", "Monte-Carlo"])
def test_the_laws_do_not_fit_their_printed_ranges(law: str) -> None:
    """Both laws lack a sign, give 4040 m/s at their smallest C_d,n, and span more than a packing can."""
    assert not finding(f"Table 4, {law}, exponent", "in the conclusions").agrees
    assert "404" in finding(f"Table 4, {law}, law", "C_d,n").computed
    assert not finding(f"Table 4, {law}, law", "C_d,n").agrees
    assert not finding(f"Table 4, {law}, range", "C_d,n").agrees


def test_the_weights_belong_to_one_coordination_number() -> None:
    """0.475 and 0.328 both follow from a coordination number of 3.05."""
    found = finding("Table 4 and Eq. 8", "0.475")
    assert found.agrees
    assert "3.05" in found.computed


def test_eleven_contents_have_too_few_wavelengths() -> None:
    """L / lambda is below 2 at 0.11 % and from 1.24 % up, by mean Vs; lambda / d50 is nowhere below 10."""
    near, long = finding("Section 3.1.3 and Tables 2, 3", "L /"), finding("Section 3.1.3 and Tables 2, 3", "d50")
    assert not near.agrees
    assert "11 of 16 contents have less: 1.90 at 0.11 %, 1.79 at 1.24 %" in near.computed  # 0.1 x 4000 / 210.4
    assert not long.agrees
    assert "16 of 16 contents have more, 13.4" in long.computed  # 282.13 / 8000 / 2.633e-3


def test_the_contacts_cannot_hold_the_largest_content() -> None:
    """Eq. 2 at every contact of the printed packing gives about half of 9 %, as it does in a packing of calcidem's."""
    found = finding("Table 2 and Eq. 2", "9 %")
    assert not found.agrees
    assert "gives 4.6 %" in found.computed
