"""`calcidem verify`: a small campaign is computed, and computed again."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.run import run
from calcidem.app.campaign.task import cell_result
from calcidem.app.config.schema import CampaignPlan, Configuration
from calcidem.app.studies.verify import Agreement, compare_outcomes, random_cells, verify
from calcidem.dem.sample.packing import PackingRule
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.rule import WaveRule
from calcidem.storage.records import CellKey

Invoke = Callable[..., str]

CONFIGURATION = Configuration(
    campaign=CampaignPlan(name="small", seeds=2, contents=(0.0, 0.66)),
    packing=PackingRule(width=0.02, height=0.03),
    wave=WaveRule(transmitter_half_width=0.005, receiver_half_width=0.006, boundary_thickness=0.005),
)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compute a campaign of a hundred disks and four cells."""
    folder = tmp_path_factory.mktemp("small")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CALCIDEM_CACHE", str(folder / "cache"))
        run(CONFIGURATION, db=folder / "small.db").close()
    return folder / "small.db"


def test_what_was_computed_here_comes_out_the_same(small: Path, invoke: Invoke) -> None:
    """On the machine that computed them all cells come out the same to the last bit, signals and cement too."""
    with open_campaign(small) as campaign:
        found = list(verify(campaign, random_cells(campaign, 100), campaign.experiment))
    assert len(found) == 4
    assert all(verification.same_cpu for verification in found)
    assert all(verification.stored.signal is not None for verification in found)
    assert [verification.differences for verification in found] == [()] * 4
    assert "2 of 2 cells confirmed" in invoke("verify", small, "--cells", 2, "--choice", 1)


def test_a_changed_database_is_found_out(small: Path, invoke: Invoke, tmp_path: Path) -> None:
    """A velocity that somebody changed by a millionth is reported, and the command ends with 1."""
    changed = tmp_path / "changed.db"
    changed.write_bytes(small.read_bytes())
    engine = create_engine(f"sqlite:///{changed}")
    with engine.begin() as connection:
        connection.execute(text("UPDATE result SET vs = vs * 1.000001"))
    engine.dispose()
    output = invoke("verify", changed, "--cells", 4, exit_code=1)
    assert "different (vs" in output


def test_why_a_sample_was_sent_again_is_kept(small: Path) -> None:
    """The problem for which the wave was sent a second time goes from the wave's record into the outcome."""
    with open_campaign(small) as campaign:
        experiment = campaign.experiment(0)
    (measured,) = measure(experiment, 0.66, [1])
    again = dataclasses.replace(measured, record=dataclasses.replace(measured.record, retry="the energy grew"))
    pairs = experiment.packing.pairs
    assert cell_result(measured, pairs, store_signals=False).retry is None
    assert cell_result(again, pairs, store_signals=False).retry == "the energy grew"


def test_another_kind_of_cpu_may_differ_within_the_error(small: Path) -> None:
    """On another kind of CPU a Vs within the stored error estimate is accepted, one beyond it is not."""
    with open_campaign(small) as campaign:
        stored = next(campaign.select(status="done", with_arrays=True))
    assert stored.vs is not None
    assert stored.error_estimate is not None
    near = dataclasses.replace(stored, vs=stored.vs * (1.0 + 0.5 * stored.error_estimate))
    far = dataclasses.replace(stored, vs=stored.vs * (1.0 + 2.0 * stored.error_estimate))
    assert compare_outcomes(stored, stored, same_cpu=False).agreement is Agreement.IDENTICAL
    assert compare_outcomes(stored, near, same_cpu=False).agreement is Agreement.WITHIN_ERROR
    assert compare_outcomes(stored, far, same_cpu=False).agreement is Agreement.DIFFERENT
    assert compare_outcomes(stored, near, same_cpu=True).agreement is Agreement.DIFFERENT


def test_choice_of_cells(small: Path) -> None:
    """The same seed chooses the same cells, and never more than there are."""
    with open_campaign(small) as campaign:
        assert random_cells(campaign, 2, 7) == random_cells(campaign, 2, 7)
        assert random_cells(campaign, 99) == tuple(CellKey(s, c) for s in (1, 2) for c in (0.0, 0.66))
