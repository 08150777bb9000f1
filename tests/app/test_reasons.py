"""Why cells have no velocity, what to try, and where their lack may bias a mean."""

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from calcidem.app.campaign.cells import cell_result
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import packing_record, section_of, section_reader
from calcidem.app.config.examples import CALIBRATED, calibration_note
from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import change_configuration, load_configuration
from calcidem.app.config.schema import CampaignPlan, Configuration, Excitation, FrequencyTable
from calcidem.app.report.page import _velocity_remarks
from calcidem.app.report.tables import count_reasons
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.reading import Reading, describe_refusal, read_section
from calcidem.dem.wave.section import Section, fitness
from calcidem.ends import Verdict
from calcidem.storage.records import CampaignRecord, canonical_json
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Workshop

SEEDS, CONTENT = (1, 2, 3, 4), 0.66


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
        pick=replace(small_configuration.pick, largest_error=0.001),
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
    return measure(experiment, CONTENT, (1,))[0].section


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
    assert "0.1% is allowed" in reason
    words = " ".join(invoke("show", unread, "--seed", 1, "--content", CONTENT, "--out", tmp_path).split())
    assert reason in words
    assert verdict.remedy in words
    assert (tmp_path / f"seed1_content{CONTENT:g}_section.png").stat().st_size > 10_000
    status = " ".join(invoke("status", unread).split())
    assert verdict.explained in status
    (counted,) = count_reasons(*(table[name].to_numpy() for name in ("status", "reason", "content")))
    assert counted == ("no_arrival", verdict.explained, [CONTENT], len(SEEDS))
    assert unread.read_bytes() == before


def test_a_stored_section_gives_the_reading_again(small_database: Path) -> None:
    """Figures and pages draw what was read, to the last bit, with the strip and the rule of the campaign."""
    with open_campaign(small_database) as campaign:
        for cell in campaign.select(content=CONTENT, status="done", with_arrays=True):
            found = section_reader(campaign.store)(cell)
            assert isinstance(found, Reading)
            assert (found.peak, found.error, found.bias) == (cell.vs_peak, cell.reading_error, cell.vs_bias)
            assert (found.wave.velocity, found.wave.coherence) == (cell.effective_vs, cell.coherence)
            assert cell.section is not None
            best = fitness(section_of(cell.section), found.wave.clamp, np.array([0.9, 1.0, 1.1]) * cell.effective_vs)
            assert best.argmax() == 1
            assert best[1] == pytest.approx(
                cell.coherence, abs=3e-3
            )  # c and the minimum are found among 200 velocities


def test_other_reasons_are_no_verdict() -> None:
    """A reason that names its own remedy, or that of an exception, has none in the table."""
    assert Verdict.of("ValueError: no motion above 0.1 % of v0 arrived") is None
    assert Verdict.of("") is None
    assert all(Verdict.of(f"{verdict}: 1") is verdict is Verdict(str(verdict)) for verdict in Verdict)


def test_each_verdict_of_a_section_has_its_number(experiment: Experiment, section: Section) -> None:
    """A section made silent, cut, or without a peak says by how much."""
    quiet = replace(section, across=section.across.copy())
    quiet.across[:, -1] //= 1000
    arrival = read_section(section, experiment.clamp)
    assert isinstance(arrival, Reading)
    cut, rising = section.until(arrival.index + 5), replace(section, across=section.across.copy())
    rising.across[:, -1] = 1000 * np.arange(len(section.across))
    strict = replace(experiment, pick=replace(experiment.pick, largest_error=1e-3))
    cases = (
        (experiment, quiet, Verdict.SILENT, f"of v0 in {1e3 * quiet.duration:.3g} ms"),
        (experiment, cut, Verdict.TOO_SHORT, f"the record ends at {1e3 * cut.duration:.3g} ms"),
        (experiment, rising, Verdict.NO_PEAK, "m/s has a coherence of"),
        (strict, section, Verdict.UNCERTAIN, "0.1% is allowed"),
    )
    assert {verdict for _, _, verdict, *_ in cases} == set(Verdict) - {Verdict.INACCURATE}
    for used, recorded, verdict, words in cases:
        found = read_section(recorded, used.clamp, used.pick)
        assert (found.verdict if isinstance(found, Reading) else found) is verdict
        assert words in describe_refusal(found, recorded, used.pick)


def test_tables_warn_of_means_in_doubt_and_advise_no_retry(unread: Path, invoke: Callable[..., str]) -> None:
    """Status and report name the contents, say how to learn why, and do not tell to retry what is deterministic."""
    said = " ".join(invoke("status", unread).split())
    assert f"Possible selection bias at {CONTENT:g} %" in said
    assert "calcidem show" in said
    assert "--retry" not in said
    with open_campaign(unread) as campaign:
        remarks = " ".join(_velocity_remarks(campaign.analyse()))
    assert f"selection bias at {CONTENT:g} %" in remarks
    assert f"Cells without velocity: {len(SEEDS)}." in remarks


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


def test_a_database_beside_the_configuration_is_named_from_another_folder(
    workshop: "Workshop", tmp_path: Path, invoke: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same file in another folder would compute all anew; the note says what continues it, and only then."""
    (tmp_path / "sand" / "results").mkdir(parents=True)
    workshop.configure(seeds=1, contents=(0.66,), name="sand/own.toml")
    monkeypatch.setenv("CALCIDEM_CACHE", str(workshop.cache))
    database = tmp_path / "sand" / "results" / "small.db"
    Store(database).close()
    monkeypatch.chdir(tmp_path)
    configuration = Path("sand", "own.toml")
    said = " ".join(invoke("run", configuration, "--check").split())
    assert "results/small.db does not exist here, but sand/results/small.db is beside the configuration" in said
    assert "give --db sand/results/small.db" in said
    assert "beside the configuration" not in invoke("run", configuration, "--check", "--db", database)
    monkeypatch.chdir(tmp_path / "sand")
    assert "beside the configuration" not in invoke("run", "own.toml", "--check")


def test_every_value_that_a_preset_calls_calibrated_is_known() -> None:
    """The keys with this comment, and no others."""
    marked = {
        f"{section}.{key}"
        for text in map(preset_text, PRESETS)
        for section, body in re.findall(r"(?ms)^\[([\w.]+)\]$(.*?)(?=^\[|\Z)", text)
        for key in re.findall(r"(?m)^(\w+) = .*# calibrated", body)
    }
    assert marked == set(CALIBRATED)
