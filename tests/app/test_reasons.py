"""Why cells have no velocity, what to try, and where their lack may bias a mean."""

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.patterns import read_candidates
from calcidem.app.campaign.stored_packing import packing_record
from calcidem.app.campaign.task import cell_result
from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import change_configuration, load_configuration
from calcidem.app.config.reference import CALIBRATED, calibration_note
from calcidem.app.config.schema import CampaignPlan, Configuration, Excitation, FrequencyTable
from calcidem.app.report.page import _velocity_remarks
from calcidem.app.report.results import count_reasons
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.reading import (
    LEAST_COHERENCE,
    PickRule,
    Reading,
    describe_refusal,
    find_candidates,
    read_section,
    velocity_spectrum,
)
from calcidem.dem.wave.section import RESOLUTION, Section
from calcidem.ends import Verdict
from calcidem.storage.records import CampaignRecord
from calcidem.storage.records.canonical import canonical_json
from calcidem.storage.sql.store import Store

SEEDS, CONTENT, SMOOTHING = (1, 2, 3, 4), 0.66, PickRule().smoothing


def store_campaign(path: Path, configuration: Configuration, packing: Packing) -> Path:
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
            store.record_results(cell_result(cell, experiment, store_sections=True) for cell in found)
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


def test_a_cell_without_velocity_has_a_reason_a_remedy_and_a_picture(
    unread: Path, tmp_path: Path, invoke: Callable[..., str]
) -> None:
    """Status, report and the cell itself say the same; the section is drawn; the database is not written."""
    before = unread.read_bytes()
    with open_campaign(unread) as campaign:
        reason = campaign.cell(seed=1, content=CONTENT).reason
        table = campaign.to_dataframe(["status", "reason", "content"])
    verdict = Verdict.of(reason)
    assert verdict is Verdict.UNCERTAIN
    assert "15.0% is allowed" in reason
    words = " ".join(invoke("show", unread, "--seed", 1, "--content", CONTENT, "--out", tmp_path).split())
    assert reason in words
    assert verdict.remedy in words
    assert (tmp_path / f"seed1_content{CONTENT:g}_section.png").stat().st_size > 10_000
    status = " ".join(invoke("status", unread).split())
    assert verdict.explained in status
    (counted,) = count_reasons(*(table[name].to_numpy() for name in ("status", "reason", "content")))
    assert counted == ("no_arrival", verdict.explained, [CONTENT], len(SEEDS))
    assert unread.read_bytes() == before


def test_the_chosen_candidate_is_the_arrival(section: Section) -> None:
    """Figures and pages mark the peak that was read, and none where none is the S wave."""
    arrival = read_section(section)
    assert isinstance(arrival, Reading)
    _, candidates, chosen = read_candidates(section, {"pick": {"smoothing": SMOOTHING}})
    assert chosen in candidates
    assert (chosen.index, chosen.travel_time) == (arrival.index, arrival.travel_time)
    assert read_candidates(section.until(len(arrival.clean) // 2 + 20), {})[2] is None


def test_other_reasons_are_no_verdict() -> None:
    """A reason that names its own remedy, or that of an exception, has none in the table."""
    assert Verdict.of("ValueError: no motion above 0.1 % of v0 arrived") is None
    assert Verdict.of("") is None
    assert all(Verdict.of(f"{verdict}: 1") is verdict is Verdict(str(verdict)) for verdict in Verdict)


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
        (experiment, quiet, Verdict.SILENT, f"of v0 in {1e3 * quiet.duration:.3g} ms"),
        (experiment, rising, Verdict.SILENT, f"reaches {reached:.2%} of v0"),
        (experiment, cut, Verdict.TOO_SHORT, f"the record ends at {1e3 * cut.duration:.3g} ms"),
        (experiment, mixed, Verdict.NO_LINE, f"{best.coherence:.3f}, {max(best.rival, LEAST_COHERENCE):.3f} is needed"),
        (strict, section, Verdict.UNCERTAIN, "0.1% is allowed"),
    )
    assert {verdict for _, _, verdict, *_ in cases} == set(Verdict)
    for used, recorded, verdict, words in cases:
        found = read_section(recorded, used.pick)
        assert (found.verdict if isinstance(found, Reading) else found) is verdict
        assert words in describe_refusal(found, recorded, used.pick)


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


def test_tables_warn_of_means_in_doubt_and_advise_no_retry(unread: Path, invoke: Callable[..., str]) -> None:
    """Status and report name the contents, say how to learn why, and do not tell to retry what is deterministic."""
    said = " ".join(invoke("status", unread).split())
    assert f"0/{len(SEEDS)} !" in said
    assert "calcidem show" in said
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
