import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from calcidem.app.config.schema import Configuration
from calcidem.app.studies import accuracy as accuracy_module
from calcidem.app.studies.accuracy import (
    DEFAULT,
    FINEST,
    HALVING,
    REFERENCE_SAMPLES,
    ReferenceCell,
    Setting,
    Study,
    Summary,
    accuracy,
    accuracy_tables,
    choose_settings,
    covered_share,
    draw_error_against_run_time,
    run_study,
    settings,
    unchecked,
)
from calcidem.app.studies.study import Cells, StudyResult, at_common_times
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment, WaveRule
from calcidem.dem.wave.propagation import prepare_recorder
from calcidem.dem.wave.reading import smooth
from calcidem.storage.errors import OutputRefusedError

pytestmark = pytest.mark.slow

CONTENTS = (0.34, 0.45, 0.55, 0.66)
SEEDS = tuple(range(1, 9))
HIGH = ((0.0, 10.0), (1.7e4, 1.7e4))  # at Table 2's the way is shorter than a wavelength, and most readings are refused
STUDIES = {"a cell": (CONTENTS[-1:], SEEDS[1:2]), "whole": (CONTENTS, SEEDS)}


@pytest.fixture(scope="module")
def experiment(small_packing: Packing) -> Experiment:
    """Give the default settings on a packing of 280 disks."""
    wave = WaveRule(
        transmitter_half_width=0.01, receiver_half_width=0.012, boundary_thickness=0.012, listening_depth=0.006
    )
    return Experiment(small_packing, cement_rule=CementRule(p_share=0.77), wave=wave, stiffness_factor=13.0)


@pytest.fixture(
    scope="module",
    params=[pytest.param((contents, seeds), marks=pytest.mark.full) for contents, seeds in STUDIES.values()],
    ids=STUDIES,
)
def study(experiment: Experiment, request: pytest.FixtureRequest) -> Study:
    """Give a study of the default and of single precision, of a pulse that suits so short a way."""
    gentle = replace(experiment.with_wave(amplitude=1e-4), frequencies=HIGH)
    single = Setting("precision float32", unchecked(gentle).with_wave(precision="float32"))
    compared = [Setting(DEFAULT, gentle), single]
    contents, seeds = request.param
    return run_study(Cells(gentle, contents, seeds), compared, coarsest=0.1, rounds=1)


def test_a_refused_campaign_ends_a_study_with_its_reason(experiment: Experiment) -> None:
    """There is nothing to compare with, so other settings are not tried."""
    fast = replace(experiment, frequencies=((0.0, 10.0), (1e7, 1e7)))
    with pytest.raises(ValueError, match="frequency"):
        Cells(fast, [0.66], SEEDS).take_turns({"default": fast, "another": experiment}, 0.66)
    with pytest.raises(ValueError, match="frequency"):
        run_study(Cells(fast, [0.66], SEEDS), [Setting(DEFAULT, fast)])


@pytest.mark.full
def test_known_contents_stay_in_a_study_that_asks_for_others(study: Study, experiment: Experiment) -> None:
    """A start with other contents loses nothing of the former ones."""
    gentle = replace(experiment.with_wave(amplitude=1e-4), frequencies=HIGH)
    known = {part.content: part for part in study.parts}
    compared = [Setting(DEFAULT, gentle), Setting("precision float32", gentle)]
    last = max(known)
    again = run_study(Cells(gentle, [last], SEEDS), compared, known={**known, 9.0: replace(known[last], content=9.0)})
    assert [part.content for part in again.parts] == [*sorted(known), 9.0]


def test_the_error_is_as_large_as_stated(study: Study) -> None:
    """Most errors of the default are within 1.96 standard errors that its content states, which are small."""
    cells = [cell for cell in study.cells if cell.setting == DEFAULT]
    assert all(cell.stated is not None for cell in cells)
    assert covered_share([cell.vs_deviation for cell in cells], [cell.stated for cell in cells]) > 0.8
    assert covered_share([cell.effective_deviation for cell in cells], [cell.stated for cell in cells]) > 0.8
    assert max(cell.stated or 0.0 for cell in cells) < 0.03
    assert all(cell.stated is None for cell in study.cells if cell.setting != DEFAULT)


def test_coverage_counts_what_has_both_numbers() -> None:
    """A missing error or standard error is no cell of the share."""
    assert covered_share([0.01, -0.03, None, 0.1], [0.01, 0.01, 0.01, None]) == 0.5
    assert np.isnan(covered_share([None], [0.1]))


def test_the_default_is_as_exact_as_promised(study: Study) -> None:
    """The default's error is below 0.5 % of Vs in the median and 2 % at worst."""
    default = study.summaries[0]
    assert default.setting == DEFAULT
    assert default.median < 0.005
    assert default.worst < 0.02
    assert default.effective_worst < 0.01
    # A pick close to the least quality may fall on either side of it; it is then no velocity, not a wrong one.
    assert default.lost <= 0.05 * default.cells


def test_a_study_is_written_as_tables_and_a_figure(study: Study) -> None:
    """The tables have a line for each setting and each content, and the figure has its axes."""
    tables = accuracy_tables(study)
    assert "| precision float32 |" in tables["settings"]
    assert all(f"| {content:g} |" in tables["contents"] for content in {cell.content for cell in study.cells})
    assert len(draw_error_against_run_time(study).axes) == 1


@pytest.mark.full
def test_what_is_left_out_has_a_reason_and_a_cost(experiment: Experiment, small_configuration: Configuration) -> None:
    """Of each setting that computes more the table has one reason, the time and the change of Vs; nothing is open."""
    cells = Cells(replace(experiment.with_wave(amplitude=1e-4), frequencies=HIGH), [0.66], SEEDS[1:3])
    parts: list[StudyResult] = []
    compared = choose_settings(cells, ["law finite", "whole domain"])
    result = accuracy(small_configuration, cells, compared, rounds=1, tell=parts.append)
    assert [part.page for part in parts] == [result.page]  # after the only content
    _, table = result.page.split("<!-- left_out -->\n")
    header, _, *rows = table.split("\n<!-- end -->")[0].splitlines()
    assert header == "| left out | why that is safe | with it | Vs changes by at most |"
    found = [row.strip("| ").split(" | ") for row in rows]
    assert [row[0] for row in found] == ["slip, opening, new contacts", "disks out of reach"]
    assert found[0][1].endswith(" mean overlaps")
    assert all(float(row[2].removesuffix(" x the time")) > 0.0 for row in found)
    assert [float(row[3]) < 1e-2 for row in found] == [True] * 2
    assert json.loads(result.json)["summaries"][1]["adds"] == "slip, opening, new contacts"


def test_a_stopped_study_goes_on(
    experiment: Experiment, small_configuration: Configuration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second start takes what the first has written, and gives the same numbers; another study refuses the file."""
    gentle = replace(experiment.with_wave(amplitude=1e-4), frequencies=HIGH, is_checked=False)
    cells = Cells(gentle, [0.55, 0.66], SEEDS[1:2])
    compared, table = choose_settings(cells, ["step_fraction 0.95"]), tmp_path / "accuracy.md"
    measured: list[float] = []

    def quick_reference(cells: Cells, content: float, _: float) -> object:
        measured.append(content)
        found, seconds = cells.measure_and_time(gentle, content)
        return found, [ReferenceCell(seed, content, cell.vs, 0.8, None) for (seed, _), cell in found.items()], seconds

    class StopError(Exception):
        """End of the first start, after its first content."""

    def write(part: StudyResult) -> None:
        list(part.write(table))
        raise StopError

    monkeypatch.setattr(accuracy_module, "find_reference", quick_reference)
    with pytest.raises(StopError):
        accuracy(small_configuration, cells, compared, rounds=1, tell=write)
    former = table.with_suffix(".json")
    (first,) = json.loads(former.read_text())["parts"]
    result = json.loads(accuracy(small_configuration, cells, compared, rounds=1, former=former).json)
    assert measured == [0.55, 0.66]  # each once
    assert [part["content"] for part in result["parts"]] == [0.55, 0.66]
    assert result["parts"][0] == first
    with pytest.raises(OutputRefusedError, match="seeds differ"):
        accuracy(small_configuration, replace(cells, seeds=SEEDS[:2]), compared, rounds=1, former=former)
    another = replace(small_configuration, sand=replace(small_configuration.sand, friction=0.4))
    with pytest.raises(OutputRefusedError, match="campaign hash differ"):
        accuracy(another, cells, compared, rounds=1, former=former)
    former.write_text("{}")
    with pytest.raises(OutputRefusedError, match="not a file of this command"):
        accuracy(small_configuration, cells, compared, rounds=1, former=former)


def test_nothing_is_left_out_that_is_computed(experiment: Experiment) -> None:
    """Single precision and the finite law change what the rows are about."""
    adds = {one.name: one.adds for one in settings(experiment, [0.66]) if one.adds}
    assert adds == {"law finite": "slip, opening, new contacts", "whole domain": "disks out of reach"}
    single = experiment.with_wave(law="finite", precision="float32")
    adds = {one.name: one.adds for one in settings(single, [0.66]) if one.adds}
    assert adds == {"precision float64": "double precision"}  # disks without contacts may get some


def test_without_a_velocity_a_study_says_so(experiment: Experiment) -> None:
    """Tables and figure of a study in which no cell can be read."""
    deaf = replace(experiment, pick=replace(experiment.pick, largest_error=1e-9))
    study = run_study(Cells(deaf, [0.66], SEEDS), [Setting(DEFAULT, deaf)], rounds=1)
    assert study.summaries[0].cells == 0
    tables = accuracy_tables(study)
    assert tables["opening"].startswith("No cell has a velocity")
    assert "| 0.66 | 0 |" in tables["contents"]
    assert len(draw_error_against_run_time(study).axes) == 1


def test_the_references_step_is_halved_until_no_velocity_moves(study: Study) -> None:
    """The last halving moved every velocity by less than 1e-4, unless the finest step was reached."""
    cells = [cell for cell in study.references if cell.halving is not None]
    assert len(cells) >= 0.93 * len(study.references)
    assert all(abs(cell.halving or 0.0) < HALVING or cell.step_fraction <= FINEST for cell in cells)
    if len(cells) >= 30:  # a median of four tells nothing
        assert np.median([abs(cell.halving or 0.0) for cell in cells]) < HALVING


@pytest.mark.full
def test_a_wave_starts_in_equilibrium(experiment: Experiment) -> None:
    """Loads hold what the packing left unbalanced: without a pulse, forces would move disks at less than 1e-15 m/s."""
    faint = experiment.with_wave(law="finite", amplitude=1e-6)
    bonded = [faint.ordering(1).at(0.66).bonded] * 8
    recorder = prepare_recorder(faint, bonded, faint.frequency(0.66), 8, lambda: None)
    assert 0.0 < recorder.unbalanced_speed.max() < 1e-9
    assert np.abs(recorder.state.scene.load).max() > 0.0


def signal_convergence(cells: Cells, *, damped: bool) -> tuple[list[float], list[float]]:
    """Change of the signal by each halving of the step, and the orders of convergence, medians over the cells.

    A change is the normalised L2 distance at the sampling times of the largest step. An order is the logarithm to base
    2 of a change over the next, without an exact solution.

    Local damping opposes the velocity half a step before, whose sign changes within a step: an error of first order.
    All other errors of the linear law are of second order.
    """
    even = replace(cells.experiment, is_checked=False, installation="preserve").with_wave(
        law="linear",
        precision="float64",
        samples_per_period=REFERENCE_SAMPLES,
        **({} if damped else {"damping": 0.0, "boundary_damping": 0.0}),
    )
    runs = [cells.measure(even.with_wave(step_fraction=step)) for step in (0.8, 0.4, 0.2, 0.1)]
    changes = []
    for cell in runs[0]:
        sections = [run[cell].section for run in runs]
        # Smoothing removes the quantisation of recorded velocities, which is as large as the smallest change.
        signals = [smooth(section.received, even.pick.smoothing * section.period) for section in sections]
        times = [section.times[: len(signal)] for section, signal in zip(sections, signals, strict=True)]
        signals = at_common_times(times, signals, times[0])
        size = np.linalg.norm(signals[-1])
        changes.append([np.linalg.norm(fine - coarse) / size for coarse, fine in pairwise(signals)])
    middle = np.median(changes, axis=0)
    return middle.tolist(), np.log2(middle[:-1] / middle[1:]).tolist()


@pytest.mark.full
def test_the_signal_converges_to_second_order_without_damping(experiment: Experiment) -> None:
    """Without damping each halving of the step divides the signal's change by four; with it by two to three."""
    cells = Cells(experiment, [5.0], SEEDS)
    undamped_changes, undamped = signal_convergence(cells, damped=False)
    damped_changes, damped = signal_convergence(cells, damped=True)
    # Velocities are recorded in steps, of which smoothing leaves half of the last change.
    assert undamped == pytest.approx([2.0, 2.0], abs=0.15)
    # The sign in local damping turns over at some instant within a step.
    assert 0.5 < np.mean(damped) < 1.6
    assert damped_changes[0] > 100.0 * undamped_changes[0]


def test_every_setting_turns_one_knob_and_has_a_name_of_its_own(experiment: Experiment) -> None:
    """The default comes first and differs from every other setting; no two names are equal."""
    rows = list(settings(experiment, [0.66]))
    assert rows[0].name == DEFAULT
    assert len({row.name for row in rows}) == len(rows)
    assert rows[0].experiment is experiment
    assert not any(row.experiment.is_checked for row in rows[1:])


def summary_of(name: str, error: float, seconds: float, *, lost: int = 0) -> Summary:
    """Make up a summary."""
    return Summary(
        setting=name,
        numerical=True,
        cells=4,
        lost=lost,
        median=error,
        worst=error,
        effective_median=error,
        effective_worst=error,
        arrival=0,
        signal=0,
        seconds=seconds,
        change=error,
    )


def test_the_cheapest_setting_is_chosen_among_those_that_meet_the_target() -> None:
    """Too large an error and lost cells rule a setting out; of the rest the fastest wins."""
    rows = (summary_of("a", 0.02, 1.0), summary_of("b", 0.004, 2.0), summary_of("c", 0.001, 3.0, lost=1))
    made_up = Study(parts=(), summaries=rows)
    chosen = made_up.cheapest(0.005)
    assert chosen is not None
    assert chosen.setting == "b"
    assert made_up.cheapest(0.0001) is None
    slow = replace(made_up, summaries=(*rows, summary_of("d", 0.02, 5.0)))
    assert [row.setting for row in slow.pareto] == ["a", "b", "c"]
