"""Disks that a wave cannot reach are left out, and nothing that is heard depends on them."""

from dataclasses import replace

import numpy as np
import pytest

from calcidem.dem.engine.scene import Law, Sand
from calcidem.dem.engine.state import SAFETY
from calcidem.dem.kernels.layout import Floats, Integers
from calcidem.dem.sample.cement import CementRule, draw_cement
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import Packing, PackingRule
from calcidem.dem.wave.experiment import Experiment, WaveRule, domain_of, listening_disks, station_disks, wave_scene
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.propagation import SAMPLES_PER_CHUNK, prepare_recorder
from calcidem.dem.wave.reading import PickRule
from calcidem.dem.wave.section import RESOLUTION, Counts
from calcidem.ends import CellStatus

RULE = WaveRule(
    transmitter_half_width=0.006,
    receiver_half_width=0.006,
    boundary_thickness=0.022,
    listening_depth=0.006,
    damping=0.05,
    law="linear",
)
FREQUENCY = 10_000.0
STRIDE = 20
SAND = Sand(shear_modulus=8e12)


@pytest.fixture(scope="module")
def packing() -> Packing:
    """Some 200 disks in a narrow, high box, most of it damping layers."""
    return make_packing(PackingRule(width=0.02, height=0.06), SAND, np.random.default_rng(3))


def bonded(packing: Packing, content: float) -> Integers:
    """Truth values (C,) of the cemented pairs."""
    return draw_cement(packing, CementRule(), seed=1, root_seed=0).at(content).bonded


def heard(packing: Packing, rule: WaveRule, content: float, time_step: float) -> tuple[Counts, Floats]:
    """(S, X) steps of velocity across, of all disks of a place, and velocities at the end of what listens."""
    experiment = Experiment(packing, sand=SAND, wave=rule)
    recorder = prepare_recorder(experiment, [bonded(packing, content)], FREQUENCY, 1, raise_if_stopped=lambda: None)
    assert time_step <= SAFETY * recorder.state.critical_time_step[0]
    recorder.stride = STRIDE
    recorder.state = replace(recorder.state, time_step=np.array([time_step]))
    (record,) = recorder.run(lambda record: len(record.across) >= 20 * SAMPLES_PER_CHUNK, lambda: None)
    velocity = recorder.state.motion.velocity[np.argsort(recorder.state.assembly.order), :2, 0]
    part = experiment.domain.packing
    groups = (*station_disks(part, rule), listening_disks(part, rule))
    return record.across * [len(disks) for disks in groups], velocity[groups[-1]]


@pytest.mark.parametrize(
    ("law", "amplitude", "content", "loudness", "noise"),
    [
        ("linear", 1e-3, 0.0, 1e-2, 1e-12),
        ("linear", 1e-3, 5.0, 1e-5, 1e-12),
        pytest.param("finite", 1e-2, 0.0, 1e-3, 1e-7, marks=pytest.mark.full),
    ],
)
def test_what_is_heard_does_not_depend_on_disks_out_of_reach(
    packing: Packing, law: Law, amplitude: float, content: float, loudness: float, noise: float
) -> None:
    """With the same step, the signal is that of the whole packing; a finite one feels it coming to rest."""
    rule = replace(RULE, law=law, amplitude=amplitude)
    whole = replace(rule, whole_domain=True)
    part = domain_of(packing, rule, "preserve").packing
    assert 0.4 < len(part.x) / len(packing.x) < 0.85
    time_step = 3e-8
    counts, exact = heard(packing, whole, content, time_step)
    same, trimmed = heard(packing, rule, content, time_step)
    # The cemented box is narrower than the wave is long.
    assert np.abs(counts[:, -1]).max() > loudness / RESOLUTION
    # Disks without contact are at rest; each mean is rounded to a step, here times the disks of a place.
    np.testing.assert_allclose(same, counts, atol=20.0, rtol=0)
    assert np.abs(exact).max() > 1e3 * noise * amplitude
    np.testing.assert_allclose(trimmed, exact, atol=noise * amplitude, rtol=0)


def test_the_whole_packing_is_kept_where_a_signal_could_come_back(packing: Packing) -> None:
    """Layers that damp by less than 1, bonds that move the sample, and a rule that says so keep every disk."""
    for rule in (replace(RULE, whole_domain=True), replace(RULE, boundary_damping=0.9, law="finite")):
        assert len(domain_of(packing, rule, "preserve").packing.x) == len(packing.x)
    assert len(domain_of(packing, RULE, "zero").packing.x) == len(packing.x)


def test_a_packing_upside_down_keeps_the_same_disks(packing: Packing) -> None:
    """The middle of the kept part is that of the packing."""
    turned = replace(packing, y=packing.height - packing.y)
    kept = domain_of(packing, RULE, "preserve").packing
    np.testing.assert_array_equal(domain_of(turned, RULE, "preserve").packing.x, kept.x)


def test_walls_of_a_wave_are_the_sides_of_the_packing(packing: Packing) -> None:
    """Every point of the rim is on the wall of its side, in the part whose span contains it, and inside the others."""
    middle, half = packing.height / 2.0, RULE.transmitter_half_width
    walls = wave_scene(packing, SAND, RULE, None).walls
    for x, y, rubbing in (
        (0.0, middle + 1.1 * half, False),
        (0.0, middle + 0.9 * half, True),
        (0.0, middle - 0.9 * half, True),
        (0.0, middle - 1.1 * half, False),
        (packing.width, middle + 1.1 * half, False),
        (packing.width, middle + 0.9 * half, True),
        (packing.width, middle - 0.9 * half, True),
        (packing.width, middle - 1.1 * half, False),
        (0.4 * packing.width, 0.0, False),
        (0.4 * packing.width, packing.height, False),
    ):
        place = np.array(x), np.array(y)
        distances = [wall.distance(*place) for wall in walls]
        (here,) = [
            wall
            for wall, distance in zip(walls, distances, strict=True)
            if distance == 0.0 and wall.span[0] <= wall.along(*place) < wall.span[1]
        ]
        assert min(distances) == 0.0
        assert here.friction == (RULE.band_friction if rubbing else 0.0)
    loaded = replace(packing, report=replace(packing.report, wall_stress=(1.0, 2.0, 3.0, 4.0)))
    assert wave_scene(loaded, SAND, RULE, None).walls[-1].servo_force == 4.0 * packing.width


def test_disks_at_the_rim_of_the_domain_are_held(packing: Packing) -> None:
    """Held are the disks that lost a neighbour, and only those; pairs and shear forces are those of the packing."""
    rule = replace(RULE, law="finite")
    domain = domain_of(packing, rule, "preserve")
    part = domain.packing
    assert domain.held.any()
    assert np.abs(part.y[domain.held] - packing.height / 2.0).min() > 0.01
    np.testing.assert_array_equal(part.preload.shear, packing.preload.shear[domain.pairs])
    for coordinate in ("x", "y"):
        given, kept = getattr(packing, coordinate), getattr(part, coordinate)
        np.testing.assert_array_equal(kept[part.pairs], given[packing.pairs[domain.pairs]])


def test_stations_record_the_mean_of_their_disks(packing: Packing) -> None:
    """Each place is the plain mean of a slice, the last one that of the receiver, in whole steps."""
    experiment = Experiment(packing, sand=SAND, wave=RULE)
    recorder = prepare_recorder(experiment, [bonded(packing, 5.0)], FREQUENCY, 1, raise_if_stopped=lambda: None)
    (record,) = recorder.run(lambda record: len(record.across) >= SAMPLES_PER_CHUNK, lambda: None)
    assert recorder.state.steps == SAMPLES_PER_CHUNK * recorder.stride
    part = domain_of(packing, RULE, "preserve").packing
    velocity = recorder.state.motion.velocity[np.argsort(recorder.state.assembly.order), :2, 0]
    listening = [*station_disks(part, RULE), listening_disks(part, RULE)]
    along, across = np.array([velocity[disks].mean(axis=0) for disks in listening]).T
    step = RULE.amplitude * RESOLUTION
    assert np.abs([along, across]).max() > 1e3 * step
    np.testing.assert_allclose(record.across[-1] * step, across, atol=0.501 * step)
    np.testing.assert_allclose(record.along[-1] * step, along, atol=0.501 * step)
    assert record.across.dtype == record.along.dtype == np.int32
    assert len(record.places) == len(listening) > 1
    np.testing.assert_allclose(record.places, [part.x[disks].mean() for disks in listening], rtol=1e-12)


def test_samples_are_taken_in_the_middle_of_every_last_step(packing: Packing) -> None:
    """Leapfrog velocities belong to half a step before the end of the step after which they are read."""
    experiment = Experiment(packing, sand=SAND, wave=RULE)
    recorder = prepare_recorder(experiment, [bonded(packing, 5.0)], FREQUENCY, 1, raise_if_stopped=lambda: None)
    recorder.record_chunk(3)
    section = recorder.section_of(0)
    assert recorder.stride > 1
    assert section.sampling_interval == pytest.approx(recorder.stride * section.time_step, rel=1e-14)
    assert section.start_time == pytest.approx(section.sampling_interval - section.time_step / 2.0, rel=1e-12)
    assert section.duration == pytest.approx(section.steps * section.time_step, rel=1e-12)


@pytest.mark.full
@pytest.mark.parametrize("lanes", [8, 16])
def test_a_cell_has_one_reading(packing: Packing, lanes: int) -> None:
    """The same bits in any batch."""
    frequency, rule = 5e4, PickRule(largest_error=1.0)  # the box is so narrow that peaks scatter
    frequencies = ((0.0, 5.0), (frequency, frequency))
    experiment = Experiment(packing, sand=SAND, wave=RULE, pick=rule, frequencies=frequencies, is_checked=False)
    cell = measure(experiment, 0.66, (5, 1, 3), lanes=lanes)[0]
    alone = measure(experiment, 0.66, [5], lanes=1)[0]
    one, other = cell.reading, alone.reading
    assert cell.status is CellStatus.DONE
    assert one is not None
    assert other is not None
    for name in ("wave", "peak", "first_arrival", "cross_correlation", "error", "bias"):
        assert getattr(one, name) == getattr(other, name)
    np.testing.assert_array_equal(cell.section.across, alone.section.across)


def test_a_kept_value_belongs_to_its_function(packing: Packing) -> None:
    """True, 1 and 1.0 are equal: what one function gave for one of them is never taken for that of another."""
    experiment = Experiment(packing)
    calls = []

    def first(_: Experiment, cemented: bool) -> str:
        calls.append(cemented)
        return "first"

    assert experiment.once(first, True) == "first"
    assert experiment.once(lambda _, stroke: f"second of {stroke}", 1.0) == "second of 1.0"
    assert experiment.once(first, True) == "first"
    assert calls == [True]
