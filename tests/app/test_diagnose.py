"""Why cells have no velocity, what to try, and where their lack may bias a mean."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from scipy.stats import norm

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.outcomes import _bias_of_failed, is_in_doubt
from calcidem.app.campaign.cure_trials import CureTrial, Verdict, contradicted_cells, rank_trials
from calcidem.app.campaign.cures import Cure, Symptoms, find_cures
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import new_packing, packing_record
from calcidem.app.campaign.task import cell_result
from calcidem.app.config.calibrated import calibration_note
from calcidem.app.config.changed import change_configuration
from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.reference import key_references
from calcidem.app.config.schema import CampaignPlan, Configuration
from calcidem.app.report.page import _velocity_remarks
from calcidem.dem.engine.scene import Regime
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.peak import PERIODS_ASKED
from calcidem.dem.wave.pick import PassedOver, PickFailure
from calcidem.storage.records import CampaignRecord, CellStatus
from calcidem.storage.records.canonical import canonical_json
from calcidem.storage.sql.store import open_store

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
def impatient(small_configuration: Configuration) -> Configuration:
    """Give a configuration that waits for waves of 3,000 m/s, which travel at less than 500."""
    return replace(
        small_configuration,
        campaign=CampaignPlan(name="impatient", seeds=SEEDS, contents=(CONTENT,)),
        wave=replace(small_configuration.wave, slowest=3000.0),
    )


@pytest.fixture(scope="module")
def unread(impatient: Configuration, small_packing: Packing, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a database without a single velocity."""
    return store_campaign(tmp_path_factory.mktemp("unread") / "unread.db", impatient, small_packing)


def test_every_unread_cell_has_a_reason_a_cure_and_a_picture(
    unread: Path, tmp_path: Path, invoke: Callable[..., str]
) -> None:
    """The command names each cell with its reason and cures, draws it, and writes nothing to the database."""
    before = unread.read_bytes()
    said = invoke("diagnose", unread, "--out", tmp_path)
    assert f"{len(SEEDS)} at {CONTENT:g} %" in said
    with open_campaign(unread) as campaign:
        for cell in campaign.diagnose():
            assert cell.status is CellStatus.NO_ARRIVAL
            assert f"seed {cell.key.seed}, {CONTENT:g} %: no arrival, {cell.reason}" in said
            assert cell.cures
            assert all(str(cure) in said for cure in cell.cures)
            assert (tmp_path / f"seed{cell.key.seed}_content{CONTENT:g}_diagnosis.png").stat().st_size > 10_000
    assert unread.read_bytes() == before


def test_a_record_that_ends_too_early_has_the_cure_to_wait(unread: Path) -> None:
    """A slower `wave.slowest` is proposed, and trying it says exactly what the changed experiment measures."""
    with open_campaign(unread) as campaign:
        diagnoses = campaign.diagnose(seed=SEEDS[:2])
        assert [cell.key.seed for cell in diagnoses] == [*SEEDS[:2]]
        waiting = [cure for cell in diagnoses for cure in cell.cures if cure.name == "wave.slowest"]
        assert all(0.0 < float(cure.value) < campaign.config["wave"]["slowest"] for cure in waiting)
        strongest = min(waiting, key=lambda cure: float(cure.value))
        trials = campaign.try_cures(diagnoses, count=2)
        (trial,) = (trial for trial in trials if trial.cure.name == "wave.slowest")
        assert trial.cure.value == strongest.value
        expected = measure(strongest.apply(campaign.experiment()), CONTENT, SEEDS[:2])
        assert trial.velocities == {cell.seed: cell.vs for cell in expected}
        assert trial.cured == sum(cell.vs is not None for cell in expected)
        assert not trial.neighbours  # no other cell is readable


def test_what_a_trial_says_is_printed(unread: Path, invoke: Callable[..., str]) -> None:
    """`--try` prints for each cure of how many cells it tells the velocity; nothing is stored."""
    before = unread.read_bytes()
    said = invoke("diagnose", unread, "--seed", 1, "--try", 1)
    assert "Tried on 1 of 1 cell; nothing is stored" in said
    with open_campaign(unread) as campaign:
        for trial in campaign.try_cures(campaign.diagnose(seed=1), count=1):
            row = next(line for line in said.splitlines() if str(trial.cure) in line and " of 1, " in line)
            assert f"{trial.cured} of 1, {trial.verdict}" in row
            read = {seed: vs for seed, vs in trial.velocities.items() if vs is not None}
            assert all(f"{vs:.0f}\N{NO-BREAK SPACE}({seed})" in row for seed, vs in read.items())
    assert unread.read_bytes() == before


def test_signals_that_were_not_stored_are_computed_again(
    unread: Path, impatient: Configuration, small_packing: Packing, tmp_path: Path
) -> None:
    """Without stored signals a cell is diagnosed as with them, to the last bit."""
    bare = store_campaign(tmp_path / "bare.db", impatient, small_packing, store_sections=False)
    with open_campaign(unread) as full, open_campaign(bare) as campaign:
        (one,), (other,) = full.diagnose(seed=2), campaign.diagnose(seed=2)
    assert other.cures == one.cures
    assert other.signal.tops == one.signal.tops
    assert np.array_equal(other.signal.received, one.signal.received)


@pytest.mark.parametrize("failure", [None, *PickFailure])
def test_every_reason_has_cures_that_can_be_set(
    failure: PickFailure | None, small_configuration: Configuration, small_packing: Packing
) -> None:
    """Whatever the reason, something is proposed: keys of the configuration, with values that it accepts."""
    experiment = small_configuration.experiment(small_packing)
    known = {f"{key.section}.{key.name}" for key in key_references()}
    for regime, verdict, travel in product(get_args(Regime), (None, *PassedOver), (None, 5e-5)):
        wave = replace(experiment.wave, regime=regime)
        changed = replace(experiment, wave=wave, method="first_arrival")
        cures = find_cures(Symptoms(changed, 24e3, failure, verdict, travel))
        assert cures
        assert {cure.name for cure in cures} <= known
        assert all(cure.needs_packing or cure.apply(changed) != changed for cure in cures)


@pytest.mark.parametrize("failure", PERIODS_ASKED)
def test_a_frequency_puts_as_many_periods_on_the_way_as_the_reading_asks_for(
    failure: PickFailure, small_configuration: Configuration, small_packing: Packing
) -> None:
    """For one period on the way the frequency becomes as many times higher, and a little more."""
    experiment, travel = small_configuration.experiment(small_packing), 4e-5
    first = find_cures(Symptoms(experiment, 1.0 / travel, failure, travel=travel))[0]
    assert first.name == "wave.frequency"
    assert PERIODS_ASKED[failure] < float(first.value) * travel < 1.25 * PERIODS_ASKED[failure]
    assert first.apply(experiment).frequency(CONTENT) == first.value


def test_cures_that_were_tried_are_ranked_by_what_came_of_them() -> None:
    """One that reads all cells and leaves the others alone comes first, one that reads none is told as failed."""
    cure = Cure("wave.frequency", 9e3, "")
    neighbours = {3: (200.0, 200.0), 4: (210.0, 211.0)}
    best = CureTrial(5.0, cure, {1: 220.0, 2: 199.0}, neighbours)
    expected = [
        (best, Verdict.WORKS),
        (replace(best, velocities={1: 230.0, 2: None}), Verdict.HELPS),
        (replace(best, neighbours={}), Verdict.UNCHECKED),
        (replace(best, neighbours={3: (200.0, 210.0)}, velocities={1: 231.0, 2: 209.0}), Verdict.MOVES),
        (replace(best, neighbours={3: (200.0, None)}, velocities={1: 221.0, 2: None}), Verdict.LOSES),
        (replace(best, velocities={1: None, 2: None}), Verdict.FAILED),
        (replace(best, velocities={}, neighbours={}, refusal="too loud"), Verdict.REFUSED),
        (replace(best, content=7.0), Verdict.WORKS),
    ]
    trials = [trial for trial, _ in expected]
    assert rank_trials(reversed(trials)) == trials
    assert [trial.verdict for trial in trials] == [verdict for _, verdict in expected]
    assert not contradicted_cells(trials), "what moves the neighbours by 5 % may move the cell as much"
    assert contradicted_cells([*trials, replace(best, velocities={1: 199.0, 2: 199.0})]) == {(5.0, 1)}


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
    assert "calcidem retry" not in said
    with open_campaign(unread) as campaign:
        remarks = " ".join(_velocity_remarks(CampaignAnalysis(campaign)))
    assert f"{CONTENT:g} % ({len(SEEDS)} of {len(SEEDS)})" in remarks


def test_calibrated_values_kept_for_another_material_are_told(tmp_path: Path, invoke: Callable[..., str]) -> None:
    """A note names the values and both moduli; there is none for a preset, nor where they were left out."""
    file = tmp_path / "own.toml"
    for preset in PRESETS:
        file.write_text(preset_text(preset), encoding="utf-8")
        assert not calibration_note(load_configuration(file))
    assert not calibration_note(change_configuration(Configuration(), {"sand.shear_modulus": 29e9}))
    file.write_text(preset_text("quick").replace("shear_modulus = 6.5e11", "shear_modulus = 29e9"), encoding="utf-8")
    said = " ".join(invoke("run", file, "--check").split())
    factor = load_configuration(file).calibration.wave_stiffness_factor
    assert f"sand.wave_stiffness_factor = {factor:g}" in said
    assert "sand.shear_modulus = 6.5e+11" in said
    assert "2.9e+10" in said
    assert "calcidem calibrate" in said


@pytest.mark.full
def test_the_first_natural_edit_is_understood(tmp_path: Path, invoke: Callable[..., str]) -> None:
    """Quartz in a box of 60 mm: a cell without a velocity has a reason, a cure and a picture; cured ones are told."""
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
        assert all(cell.reason and cell.cures and cell.finding for cell in diagnoses)
        assert len(list((tmp_path / "pictures").iterdir())) == min(12, len(diagnoses))
        experiment = campaign.experiment()
        for trial in campaign.try_cures(diagnoses, count=3):
            seeds = [*trial.velocities, *trial.neighbours]
            vs = {cell.seed: cell.vs for cell in measure(trial.cure.apply(experiment), trial.content, seeds)}
            assert trial.velocities == {seed: vs[seed] for seed in trial.velocities}
            assert {seed: after for seed, (_, after) in trial.neighbours.items()} == {
                s: vs[s] for s in trial.neighbours
            }
