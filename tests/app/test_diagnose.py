"""Why cells have no velocity, what to try, and where their lack may bias a mean."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from scipy.stats import norm

from calcidem.analysis.doubt import _bias_of_failed, is_in_doubt
from calcidem.app.campaign.diagnosis import diagnose
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import new_packing
from calcidem.app.campaign.remedies import Case, Remedy, explain_refusal, look_at_packing
from calcidem.app.campaign.remedy_trials import RemedyTrial, TrialOutcome, rank_trials
from calcidem.app.campaign.stored_packing import packing_record
from calcidem.app.campaign.task import cell_result
from calcidem.app.config.calibrated import calibration_note
from calcidem.app.config.changed import change_configuration
from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.reference import key_references
from calcidem.app.config.schema import CampaignPlan, Configuration, Excitation, FrequencyTable
from calcidem.app.report.page import _velocity_remarks
from calcidem.dem.engine.scene import Regime
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.error_estimate import ErrorParts, NumericalError
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.reading import (
    LEAST_COHERENCE,
    Verdict,
    find_candidates,
    read_section,
    record_duration,
    velocity_spectrum,
)
from calcidem.dem.wave.section import Section
from calcidem.storage.records import CampaignRecord, CellStatus
from calcidem.storage.records.canonical import canonical_json
from calcidem.storage.sql.store import open_store
from calcidem.storage.store import Selection

SEEDS, CONTENT = (1, 2, 3, 4), 0.66


def store_campaign(path: Path, configuration: Configuration, packing: Packing, *, store_sections: bool = True) -> Path:
    """Compute a campaign and store it."""
    plan, experiment = configuration.campaign, configuration.experiment(packing)
    with open_store(path) as store:
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
def case(small_configuration: Configuration, small_packing: Packing) -> Case:
    """Give a cell that has a velocity."""
    experiment = small_configuration.experiment(small_packing)
    return case_of(experiment, measure(replace(experiment, early_stop=False), CONTENT, (1,))[0].record.section)


def case_of(experiment: Experiment, section: Section) -> Case:
    """Read a section."""
    pick = experiment.pick
    return Case(experiment, section, read_section(section, pick), find_candidates(section, pick.smoothing), None)


def undecided(case: Case) -> Section:
    """Section that ends a little before the arrival is certain."""
    arrival = case.reading.arrival
    assert arrival is not None
    (decided,) = (one.decided for one in case.candidates if one.index == arrival.index)
    return case.section.until(int(0.9 * decided / case.section.sampling_interval))


def test_every_unread_cell_has_its_number_a_remedy_and_a_picture(
    unread: Path, tmp_path: Path, invoke: Callable[..., str]
) -> None:
    """The command looks at the packing first, says of each cell what refused it, draws it, and stores nothing."""
    before = unread.read_bytes()
    said = invoke("diagnose", unread, "--out", tmp_path)
    assert f"{len(SEEDS)} at {CONTENT:g} %" in said
    words = " ".join(said.split())
    with open_campaign(unread) as campaign:
        cells = campaign.diagnose()
        for cell in cells:
            assert f"seed {cell.key.seed}, {CONTENT:g} %: no arrival, {cell.reason}" in said
            assert cell.finding in words
            assert f"{cell.case.reading.error:.1%}; {campaign.config['pick']['largest_error']:.1%} is allowed" in words
            assert cell.remedies[0].name == "wave.frequency"
            assert all(str(remedy) in said for remedy in cell.remedies)
            assert (tmp_path / f"seed{cell.key.seed}_content{CONTENT:g}_diagnosis.png").stat().st_size > 10_000
    assert [cell.key.seed for cell in cells] == [*SEEDS]
    assert 0 < said.index("Look at the packing first: Porosity") < said.index("seed 1,")
    assert unread.read_bytes() == before


def test_the_wavelengths_that_are_asked_for_give_velocities(unread: Path, invoke: Callable[..., str]) -> None:
    """With the highest frequency proposed most cells are read, as the changed experiment measures them."""
    before = unread.read_bytes()
    said = invoke("diagnose", unread, "--try", len(SEEDS))
    assert f"Tried on {len(SEEDS)} of {len(SEEDS)} cells; nothing is stored" in said
    with open_campaign(unread) as campaign:
        diagnoses = campaign.diagnose()
        trials = campaign.try_remedies(diagnoses, count=len(SEEDS))
        (trial,) = (trial for trial in trials if trial.remedy.name == "wave.frequency")
        assert trial.remedy.value == max(cell.remedies[0].value for cell in diagnoses)
        expected = measure(trial.remedy.apply(campaign.experiment()), CONTENT, SEEDS)
    assert trial.velocities == {cell.seed: cell.vs for cell in expected}
    assert trial.read > len(SEEDS) / 2
    assert not trial.neighbours
    row = next(line for line in said.splitlines() if str(trial.remedy) in line and " of 4, " in line)
    assert f"{trial.read} of 4, {trial.outcome}" in row
    assert f"frequency = [{trial.remedy.value:g}" in said.replace(".0]", "]")
    assert unread.read_bytes() == before


def test_sections_that_were_not_stored_are_computed_again(
    unread: Path, slow_pulse: Configuration, small_packing: Packing, tmp_path: Path
) -> None:
    """Without stored sections a cell is diagnosed as with them, to the last bit; with them nothing is computed."""
    bare = store_campaign(tmp_path / "bare.db", slow_pulse, small_packing, store_sections=False)
    told: list[str] = []
    with open_campaign(unread) as full, open_campaign(bare) as campaign:
        (one,), (other,) = diagnose(full.store, Selection(2), told.append), campaign.diagnose(seed=2)
    assert not told
    assert (other.finding, other.remedies) == (one.finding, one.remedies)
    assert np.array_equal(other.case.section.across, one.case.section.across)


def test_each_verdict_has_its_number_and_a_remedy_for_it(case: Case, slow_pulse: Configuration) -> None:
    """A section made silent, cut, put out of order or of long waves says by how much, and what changes that."""
    experiment, section = case.experiment, case.section
    assert case.reading.arrival is not None
    silent = replace(section, across=section.across // 1000, along=section.along // 1000)
    cut = undecided(case)
    order = [*reversed(range(len(section.places) - 1)), -1]
    mixed = replace(section, across=np.roll(section.across, 40, axis=0)[:, order])
    mixed.across[:, -1] = section.across[:, -1]
    low = replace(experiment, frequencies=((0.0, 100.0), slow_pulse.excitation.table.frequency * 2))
    long_waves = measure(low, CONTENT, (1,))[0].record.section
    known = {f"{key.section}.{key.name}" for key in key_references()}
    expected = (
        (silent, Verdict.SILENT, "is needed", {"wave.frequency", "wave.damping"}),
        (cut, Verdict.TOO_SHORT, f"the record ends at {1e3 * cut.duration:.3g} ms", {"wave.slowest"}),
        (mixed, Verdict.NO_LINE, f"{LEAST_COHERENCE:g} is needed", {"wave.frequency"}),
        (long_waves, Verdict.UNCERTAIN, "near field", {"wave.frequency", "pick.largest_error"}),
    )
    assert {verdict for _, verdict, *_ in expected} == set(Verdict)
    for recorded, verdict, words, names in expected:
        found = case_of(experiment, recorded)
        number, remedies = explain_refusal(found)
        assert found.reading.verdict is verdict
        assert words in number
        proposed = {remedy.name for remedy in remedies}
        assert names <= proposed <= known
        assert all(remedy.needs_packing or remedy.apply(experiment) != experiment for remedy in remedies)


def test_a_longer_record_is_as_long_as_the_decision_needs(case: Case) -> None:
    """The proposed `wave.slowest` makes a record in which the peak is decided, and not three times as long."""
    experiment, section = case.experiment, case.section
    cut = case_of(experiment, undecided(case))
    (remedy,) = (one for one in explain_refusal(cut)[1] if one.name == "wave.slowest")
    needed = min(one.decided for one in cut.candidates if one.decided > cut.section.duration)
    length = record_duration(section.distance, float(remedy.value), section.frequency, experiment.pick.smoothing)
    present = record_duration(section.distance, experiment.wave.slowest, section.frequency, experiment.pick.smoothing)
    assert length >= needed
    assert length < 1.3 * max(needed, present)


@pytest.mark.parametrize("part", ErrorParts._fields)
def test_the_largest_part_of_the_numerical_error_has_a_remedy(part: str, case: Case) -> None:
    """Whatever makes the numerical error, its size is said, and a key is proposed with a value that it accepts."""
    parts = ErrorParts(**{name: 0.2 if name == part else 0.0 for name in ErrorParts._fields})
    for regime in get_args(Regime):
        experiment = replace(case.experiment, wave=replace(case.experiment.wave, regime=regime, precision="float32"))
        error = NumericalError(0.02, 0.2, parts)
        number, remedies = explain_refusal(replace(case, experiment=experiment, error=error))
        assert f"{part} (20.0%)" in number
        assert remedies
        assert all(remedy.apply(experiment) != experiment for remedy in remedies)


def test_the_spectrum_passes_through_the_candidates(case: Case) -> None:
    """The arrival is one of the candidates, and the spectrum at its velocity is its coherence."""
    arrival = case.reading.arrival
    assert arrival is not None
    (same,) = (one for one in case.candidates if one.index == arrival.index)
    assert (same.travel_time, same.coherence) == (arrival.travel_time, arrival.coherence)
    velocities = np.array([case.section.distance / one.travel_time for one in case.candidates])
    spectrum = velocity_spectrum(case.section, case.experiment.pick.smoothing, velocities)
    assert spectrum == pytest.approx(
        [one.coherence for one in case.candidates], abs=1e-2
    )  # P is taken off up to a sample
    assert np.isnan(velocity_spectrum(case.section, case.experiment.pick.smoothing, np.array([1.0])))


def test_a_packing_that_carries_no_wave_is_told(small_packing: Packing) -> None:
    """Deep overlaps ask for less stress, too few contacts for a denser packing; a good one asks for nothing."""
    assert look_at_packing(small_packing, 1e11)[1] == ()
    report, radius = small_packing.report, float(small_packing.radius.mean())
    deep = replace(small_packing, report=replace(report, largest_overlap=0.2 * radius))
    (stress,) = look_at_packing(deep, 1e11)[1]
    assert stress.name == "packing.stress"
    assert 0.2 < float(stress.value) / max(report.wall_stress) < 0.5**1.5
    loose = replace(small_packing, report=replace(report, coordination_number_without_rattlers=2.5))
    text, (porosity,) = look_at_packing(loose, 1e11)
    assert "2.50 contacts per disk" in text
    assert porosity.name == "packing.porosity"
    assert float(porosity.value) < report.porosity


def test_tried_remedies_are_ranked_by_their_outcome() -> None:
    """One that reads all cells and leaves the others alone comes first, one that reads none has failed."""
    remedy = Remedy("wave.frequency", 9e3, "")
    best = RemedyTrial(5.0, remedy, {1: 220.0, 2: 199.0}, {3: (200.0, 200.0), 4: (210.0, 211.0)})
    expected = [
        (best, TrialOutcome.WORKS),
        (replace(best, velocities={1: 230.0, 2: None}), TrialOutcome.HELPS),
        (replace(best, neighbours={}), TrialOutcome.UNCHECKED),
        (replace(best, neighbours={3: (200.0, 210.0)}), TrialOutcome.MOVES),
        (replace(best, neighbours={3: (200.0, None)}, velocities={1: 221.0, 2: None}), TrialOutcome.LOSES),
        (replace(best, velocities={1: None, 2: None}), TrialOutcome.FAILED),
        (replace(best, velocities={}, neighbours={}, refusal="too loud"), TrialOutcome.REFUSED),
        (replace(best, content=7.0), TrialOutcome.WORKS),
    ]
    trials = [trial for trial, _ in expected]
    assert rank_trials(reversed(trials)) == trials
    assert [trial.outcome for trial in trials] == [outcome for _, outcome in expected]


@pytest.mark.parametrize(("measured", "failed"), [(7, 1), (5, 3), (111, 5), (39, 9)])
def test_the_bias_of_a_mean_is_that_of_a_normal_distribution_without_its_end(measured: int, failed: int) -> None:
    """Values of a normal distribution at equal steps of probability, less those at one end, have this mean."""
    values = norm.ppf((np.arange(200_000) + 0.5) / 200_000)
    left = values[round(len(values) * failed / (measured + failed)) :]
    assert _bias_of_failed(measured, failed) == pytest.approx(left.mean(), rel=1e-3)
    assert _bias_of_failed(measured, 0) == 0.0
    assert is_in_doubt(measured, failed) == (left.mean() > 1.0 / np.sqrt(measured))


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
        assert all(cell.reason and cell.remedies and cell.finding for cell in diagnoses)
        assert len(list((tmp_path / "pictures").iterdir())) == min(12, len(diagnoses))
        experiment = campaign.experiment()
        for trial in campaign.try_remedies(diagnoses, count=3):
            seeds = [*trial.velocities, *trial.neighbours]
            vs = {cell.seed: cell.vs for cell in measure(trial.remedy.apply(experiment), trial.content, seeds)}
            assert trial.velocities == {seed: vs[seed] for seed in trial.velocities}
            assert {seed: after for seed, (_, after) in trial.neighbours.items()} == {
                s: vs[s] for s in trial.neighbours
            }
