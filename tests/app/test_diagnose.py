"""Why cells have no velocity, what to try, and where their lack may bias a mean."""

import re
from collections.abc import Callable
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calcidem.app.campaign.diagnosis import (
    _NAMED,
    _experiment_with,
    _explain_refusal,
    _find_remedies,
    _judged_packing,
    _trial_values,
    diagnose,
)
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import new_packing
from calcidem.app.campaign.stored_packing import packing_record
from calcidem.app.campaign.task import cell_result
from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import change_configuration, load_configuration
from calcidem.app.config.reference import CALIBRATED, calibration_note, key_references
from calcidem.app.config.schema import CampaignPlan, Configuration, Excitation, FrequencyTable
from calcidem.app.report.page import _velocity_remarks
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave import reading
from calcidem.dem.wave.experiment import WAVELENGTHS, Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.reading import (
    LEAST_COHERENCE,
    PickRule,
    Reading,
    Verdict,
    find_candidates,
    read_section,
    velocity_spectrum,
)
from calcidem.dem.wave.section import RESOLUTION, Section
from calcidem.storage.records import CampaignRecord, CellStatus
from calcidem.storage.records.canonical import canonical_json
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection

SEEDS, CONTENT, SMOOTHING = (1, 2, 3, 4), 0.66, PickRule().smoothing


def test_words_that_name_a_remedy_are_written_by_the_wave() -> None:
    """A reason that is worded anew would lose its remedy without a word."""
    wave = Path(reading.__file__).parent
    written = "".join(file.read_text(encoding="utf-8") for file in sorted(wave.glob("*.py")))
    assert [words for words in _NAMED if words not in written] == []


def store_campaign(path: Path, configuration: Configuration, packing: Packing, *, store_sections: bool = True) -> Path:
    """Compute a campaign and store it."""
    plan, experiment = configuration.campaign, configuration.experiment(packing)
    with Store(path) as store:
        physics = canonical_json(configuration.physics)
        store.begin_campaign(
            CampaignRecord(configuration.hash, plan.name, physics, plan.contents, plan.seed_numbers, datetime.now(UTC))
        )
        store.save_packing(packing_record(packing, index=0, packing_hash=configuration.packing_hash))
        for content in plan.contents:
            found = measure(experiment, content, plan.seed_numbers)
            store.record_results(cell_result(cell, experiment, store_sections) for cell in found)
    return path


@pytest.fixture(scope="module")
def slow_pulse(small_configuration: Configuration) -> Configuration:
    """Give a configuration whose pulse has half a wavelength on the path."""
    return replace(
        small_configuration,
        campaign=CampaignPlan(name="slow pulse", seeds=SEEDS, contents=(CONTENT,)),
        excitation=Excitation(FrequencyTable((CONTENT,), (8.4e3,))),
        pick=replace(small_configuration.pick, largest_error=0.15),
    )


@pytest.fixture(scope="module")
def unread(slow_pulse: Configuration, small_packing: Packing, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a database without a single velocity."""
    return store_campaign(tmp_path_factory.mktemp("unread") / "unread.db", slow_pulse, small_packing)


@pytest.fixture(scope="module")
def experiment(small_configuration: Configuration, small_packing: Packing) -> Experiment:
    """Give an experiment in which waves are read."""
    return small_configuration.experiment(small_packing)


@pytest.fixture(scope="module")
def section(experiment: Experiment) -> Section:
    """Give the section of a cell that has a velocity."""
    return measure(replace(experiment, early_stop=False), CONTENT, (1,))[0].section


def test_every_unread_cell_has_its_number_a_remedy_and_a_picture(
    unread: Path, tmp_path: Path, invoke: Callable[..., str]
) -> None:
    """The command looks at the packing first, says what refused a cell and what gives Vs, draws it, stores nothing."""
    before = unread.read_bytes()
    said = invoke("diagnose", unread, "--seed", 1, "--out", tmp_path)
    words = " ".join(said.split())
    with open_campaign(unread) as campaign:
        (cell,) = campaign.diagnose(seed=1)
        (expected,) = measure(_experiment_with(campaign.experiment(), cell.remedies), CONTENT, (1,))
        allowed = campaign.config["pick"]["largest_error"]
    assert f"{len(SEEDS)} at {CONTENT:g} %" in said
    assert f"seed 1, {CONTENT:g} %: no arrival, {cell.reason}" in words
    assert cell.finding in words
    assert (
        0 < said.index("Look at the packing first: Porosity") < words.index(f"{cell.reading.error:.1%}; {allowed:.1%}")
    )
    assert cell.remedies == {"wave.frequency": "auto"}
    assert cell.vs == expected.vs
    assert cell.expected[0] < expected.vs < cell.expected[1]
    assert f"Vs is {expected.vs:.0f} m/s with" in said
    assert 'wave.frequency = "auto"' in said
    assert (tmp_path / f"seed1_content{CONTENT:g}_diagnosis.png").stat().st_size > 10_000
    assert unread.read_bytes() == before
    fast = replace(cell, vs=1e4).draw()
    assert fast.axes[1].get_xlim()[1] > 1e4  # the spectrum reaches beyond the remedy


def test_a_record_that_is_too_short_becomes_long_enough(
    small_configuration: Configuration, small_packing: Packing, tmp_path: Path
) -> None:
    """The proposed `wave.slowest` gives the velocity that the sample has with any long record."""
    plan = CampaignPlan(name="short", seeds=(1,), contents=(CONTENT,))
    short = replace(small_configuration, campaign=plan, wave=replace(small_configuration.wave, slowest=2000.0))
    with open_campaign(store_campaign(tmp_path / "short.db", short, small_packing)) as campaign:
        (cell,) = campaign.diagnose()
    assert cell.reading is Verdict.TOO_SHORT
    assert f"the record ends at {1e3 * cell.section.duration:.3g} ms" in cell.finding
    assert list(cell.remedies) == ["wave.slowest"]
    (expected,) = measure(small_configuration.experiment(small_packing), CONTENT, (1,))
    assert cell.vs == expected.vs


def test_sections_that_were_not_stored_are_computed_again(
    unread: Path, slow_pulse: Configuration, small_packing: Packing, tmp_path: Path
) -> None:
    """Without stored sections a cell is diagnosed as with them, to the last bit."""
    bare = store_campaign(tmp_path / "bare.db", slow_pulse, small_packing, store_sections=False)
    with open_campaign(unread) as full, open_campaign(bare) as campaign:
        (one,), (other,) = diagnose(full.store, Selection(2)), campaign.diagnose(seed=2)
    assert (other.finding, other.remedies, other.vs) == (one.finding, one.remedies, one.vs)
    assert np.array_equal(other.section.across, one.section.across)


def test_each_verdict_has_its_number(experiment: Experiment, section: Section) -> None:
    """A section made silent, cut, or put out of order says by how much."""
    quiet = replace(section, across=section.across.copy())
    quiet.across[:, -1] //= 1000
    arrival = read_section(section)
    assert isinstance(arrival, Reading)
    cut, rising = section.until(len(arrival.clean) // 2 + 20), section.until(arrival.index - 5)
    reached = np.abs(rising.across[:, -1]).max() * RESOLUTION
    order = [*reversed(range(len(section.places) - 1)), -1]
    mixed = replace(section, across=np.roll(section.across, 40, axis=0)[:, order])
    mixed.across[:, -1] = section.across[:, -1]
    best = max(find_candidates(mixed, SMOOTHING), key=lambda one: one.coherence)
    strict = replace(experiment, pick=replace(experiment.pick, largest_error=1e-3))
    cases = (
        (experiment, quiet, Verdict.SILENT, "of v0, with no peak above 0.1%"),
        (experiment, rising, Verdict.SILENT, f"reaches {reached:.2%} of v0"),
        (experiment, cut, Verdict.TOO_SHORT, f"the record ends at {1e3 * cut.duration:.3g} ms"),
        (experiment, mixed, Verdict.NO_LINE, f"{best.coherence:.3f}; {max(best.rival, LEAST_COHERENCE):.3f} is needed"),
        (strict, section, Verdict.UNCERTAIN, "0.1% is allowed"),
    )
    assert {verdict for _, _, verdict, *_ in cases} == set(Verdict)
    for used, recorded, verdict, words in cases:
        reading = read_section(recorded, used.pick)
        assert (reading.verdict if isinstance(reading, Reading) else reading) is verdict
        assert words in _explain_refusal(used, recorded, reading, None)


def test_values_to_try_are_keys_that_change_the_experiment(experiment: Experiment, section: Section) -> None:
    """Each exists; the frequency is among them if the path departs from 2.5 wavelengths, a weaker bound if it helps."""
    speed = section.distance * section.frequency / WAVELENGTHS
    strict = replace(experiment, pick=replace(experiment.pick, largest_error=1e-3))
    better = _trial_values(strict, section, 2.0 * speed)
    assert {"wave.frequency", "wave.receiver_half_width", "wave.transmitter", "pick.largest_error"} <= set(better)
    assert set(better) <= {f"{key.section}.{key.name}" for key in key_references()}
    assert all(_experiment_with(strict, {name: value}) != strict for name, value in better.items())
    usual = _trial_values(experiment, section, speed)
    assert not {"wave.frequency", "pick.largest_error"} & set(usual)
    assert not _trial_values(_experiment_with(experiment, usual), section, speed)


_Found = tuple[str, float | None, dict[str, Any]]


@pytest.fixture
def find(
    monkeypatch: pytest.MonkeyPatch, experiment: Experiment, section: Section
) -> Callable[[Callable[[set[str]], float | str], str], _Found]:
    """Give what is said of a sample if waves have these velocities, m/s, or reasons for none; 200 to 375 is expected.

    A velocity depends on the keys of section wave that differ, and that of its packing is 300 m/s.
    """

    def found(outcome: Callable[[set[str]], float | str], reason: str) -> _Found:
        def measured(used: Experiment, content: float, seeds: list[int]) -> tuple[object]:
            assert (content, seeds) == (CONTENT, [1])
            names = asdict(experiment.wave).items()
            vs = outcome({name for name, value in names if value != getattr(used.wave, name)})
            if isinstance(vs, str):
                return (SimpleNamespace(vs=None, reason=vs),)
            return (SimpleNamespace(vs=vs, reason=""),)

        monkeypatch.setattr("calcidem.app.campaign.diagnosis.measure", measured)
        cell = SimpleNamespace(reason=reason, key=SimpleNamespace(content=CONTENT, seed=1))
        return _find_remedies(experiment, cell, section, 300.0, (200.0, 375.0))

    return found


def test_superfluous_values_are_not_named(find: Callable[..., _Found]) -> None:
    """Of all values those are named without any of which there is no velocity; one alone suffices if it can."""
    needed = {"receiver_half_width", "transmitter"}
    _, vs, remedies = find(lambda changed: 310.0 if needed <= changed else "no line", "no line")
    assert (vs, set(remedies)) == (310.0, {f"wave.{name}" for name in needed})
    text, vs, remedies = find(lambda changed: 310.0 if "transmitter" in changed else "no line", "no line")
    assert (vs, remedies) == (310.0, {"wave.transmitter": "driven"})
    assert "All trial values together give 310 m/s, 1.03 times the static speed" in text


def test_where_all_values_are_too_many_fewer_are_tried(find: Callable[..., _Found]) -> None:
    """If all of them together read nothing, those at the end of the list are left out, the last first."""
    needed = {"receiver_half_width", "transmitter_half_width"}
    read = lambda changed: 310.0 if needed <= changed and "transmitter" not in changed else "no line"  # noqa: E731
    text, vs, remedies = find(read, "no line")
    assert "together give no velocity: no line." in text
    assert (vs, set(remedies)) == (310.0, {f"wave.{name}" for name in needed})


def test_reasons_name_values(find: Callable[..., _Found]) -> None:
    """What a cell's reason and those of trials name is added to the other values, and left out if superfluous."""
    slips = lambda changed: 310.0 if "regime" in changed else "lower amplitude, or choose regime = 'finite'"  # noqa: E731
    _, vs, remedies = find(slips, "lower amplitude")
    assert (vs, remedies) == (310.0, {"wave.regime": "finite"})
    damped = lambda changed: 310.0 if {"damping", "amplitude"} <= changed else "lower amplitude"  # noqa: E731
    assert find(damped, "lower amplitude")[1:] == (None, {})  # damping is tried where no reason names a value
    damped = lambda changed: 310.0 if "damping" in changed else "silent"  # noqa: E731
    assert list(find(damped, "silent")[2]) == ["wave.damping"]


def test_a_velocity_far_from_the_static_speed_is_told(find: Callable[..., _Found]) -> None:
    """All values together say what others agree with; an expected velocity is better; far from it none is named."""
    fast = lambda changed: 500.0 if "transmitter" in changed else "no line"  # noqa: E731
    text, vs, remedies = find(fast, "no line")
    assert "500 m/s, 1.67 times the static speed." in text
    assert (vs, remedies) == (500.0, {"wave.transmitter": "driven"})
    some = lambda changed: 310.0 if changed == {"transmitter"} else 500.0  # noqa: E731
    assert find(some, "no line")[1:] == (310.0, {"wave.transmitter": "driven"})
    far = lambda changed: 900.0 if "transmitter" in changed else "no line"  # noqa: E731
    text, vs, remedies = find(far, "no line")
    assert "900 m/s, 3.00 times the static speed. They are" in text
    assert 'wave.transmitter = "driven"' in text
    assert text.endswith("Velocities with one of them: 900 m/s.")
    assert (vs, remedies) == (None, {})


def test_a_large_numerical_error_says_its_bound(experiment: Experiment, section: Section) -> None:
    """Its remedy is in the reason; the section supports none."""
    reading = read_section(section, experiment.pick)
    assert "20.0%; 5% is allowed" in _explain_refusal(experiment, section, reading, 0.2)


def test_the_spectrum_passes_through_the_candidates(section: Section) -> None:
    """The arrival is one of the candidates, and the spectrum at its velocity is its coherence."""
    arrival, candidates = read_section(section), find_candidates(section, SMOOTHING)
    assert isinstance(arrival, Reading)
    (same,) = (one for one in candidates if one.index == arrival.index)
    assert (same.travel_time, same.coherence) == (arrival.travel_time, arrival.coherence)
    velocities = np.array([section.distance / one.travel_time for one in candidates])
    spectrum = velocity_spectrum(section, SMOOTHING, velocities)
    assert spectrum == pytest.approx([one.coherence for one in candidates], abs=1e-2)  # P is taken off up to a sample
    assert np.isnan(velocity_spectrum(section, SMOOTHING, np.array([1.0])))


def test_a_packing_that_carries_no_wave_is_told(experiment: Experiment) -> None:
    """Deep overlaps and too few contacts are described with their remedies; a good packing is described alone."""
    packing = experiment.packing
    assert "packing." not in _judged_packing(experiment)
    deep = replace(experiment, packing=replace(packing, radius=1.05 * packing.radius))
    assert "packing.stress: the largest overlap" in _judged_packing(deep)
    report = replace(packing.report, coordination_number_without_rattlers=2.5)
    text = _judged_packing(replace(experiment, packing=replace(packing, report=report)))
    assert "2.50 contacts per disk" in text
    assert "lower packing.porosity" in text


def test_tables_warn_of_means_in_doubt_and_advise_no_retry(unread: Path, invoke: Callable[..., str]) -> None:
    """Status and report name the contents, say how to learn why, and do not tell to retry what is deterministic."""
    said = " ".join(invoke("status", unread).split())
    assert f"0/{len(SEEDS)} !" in said
    assert "calcidem diagnose" in said
    assert "--retry" not in said
    with open_campaign(unread) as campaign:
        remarks = " ".join(_velocity_remarks(campaign.analyse()))
    assert f"{CONTENT:g} % ({len(SEEDS)} of {len(SEEDS)})" in remarks


def test_calibrated_values_kept_for_another_material_are_told(tmp_path: Path, invoke: Callable[..., str]) -> None:
    """A note names the values and both moduli; there is none for a preset, nor where they were left out."""
    file = tmp_path / "own.toml"
    for preset in PRESETS:
        file.write_text(preset_text(preset), encoding="utf-8")
        assert not calibration_note(load_configuration(file))
    softer = {"sand.shear_modulus": 29e9, "wave.frequency": 2e3}
    assert not calibration_note(change_configuration(Configuration(), softer))
    file.write_text(preset_text("quick").replace("shear_modulus = 6.5e11", "shear_modulus = 5e11"), encoding="utf-8")
    said = " ".join(invoke("run", file, "--check").split())
    factor = load_configuration(file).calibration.wave_stiffness_factor
    assert f"sand.wave_stiffness_factor = {factor:g}" in said
    assert "sand.shear_modulus = 6.5e+11" in said
    assert "5e+11" in said
    assert "calcidem calibrate" in said


def test_every_value_that_a_preset_calls_calibrated_is_known() -> None:
    """The keys with this comment, and no others."""
    marked = {
        f"{section}.{key}"
        for text in map(preset_text, PRESETS)
        for section, body in re.findall(r"(?ms)^\[([\w.]+)\]$(.*?)(?=^\[|\Z)", text)
        for key in re.findall(r"(?m)^(\w+) = .*# calibrated", body)
    }
    assert marked == set(CALIBRATED)


@pytest.mark.full
def test_the_first_natural_edit_is_understood(tmp_path: Path, invoke: Callable[..., str]) -> None:
    """Quartz in a box of 60 mm: a cell without a velocity has a reason, a remedy and a picture; trials are true."""
    values = {
        "campaign.name": "quartz",
        "campaign.seeds": 8,
        "campaign.contents": [0.66, 5.0, 7.0],
        "packing.width": 0.06,
        "packing.height": 0.12,
        "wave.receiver_half_width": 0.02,
        "wave.boundary_thickness": 0.02,
        "sand.shear_modulus": 29e9,
    }
    (tmp_path / "own.toml").write_text(preset_text("paper-small-pulse"), encoding="utf-8")
    quartz = change_configuration(tmp_path / "own.toml", values)
    assert "2.9e+10" in calibration_note(quartz)
    packing = new_packing(quartz, lambda _: None, lambda: None, lambda _: None)
    database = store_campaign(tmp_path / "quartz.db", quartz, packing)
    invoke("diagnose", database, "--out", tmp_path / "pictures")
    with open_campaign(database) as campaign:
        diagnoses = campaign.diagnose()
        assert len(diagnoses) == sum(
            campaign.status_counts().get((c, CellStatus.NO_ARRIVAL), 0) for c in campaign.record.contents
        )
        assert all(cell.reason and cell.finding for cell in diagnoses)
        for cell in (cell for cell in diagnoses[:3] if cell.remedies):
            (found,) = measure(
                _experiment_with(campaign.experiment(), cell.remedies), cell.key.content, (cell.key.seed,)
            )
            assert cell.vs == found.vs
        assert len(list((tmp_path / "pictures").iterdir())) == len(diagnoses)
