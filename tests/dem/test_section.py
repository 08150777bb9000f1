"""The section of a sample: whole steps of velocity, and where and when they were taken."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import RADIUS, bare_packing, hexagonal
from waves import AMPLITUDE, FREQUENCY, section, total, wave

from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import WaveRule, listening_disks, station_disks
from calcidem.dem.wave.reading import Reading, read_section
from calcidem.dem.wave.section import RESOLUTION, Pulse, quantise


@given(st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=20), st.floats(1e-6, 10.0))
def test_a_velocity_is_known_to_half_a_step(velocities: list[float], amplitude: float) -> None:
    """A step is 2^-20 of the pulse's amplitude, and what has been rounded stays as it is."""
    velocity = amplitude * np.array(velocities)
    counts = quantise(velocity, amplitude)
    assert counts.dtype == np.int32
    np.testing.assert_allclose(counts * amplitude / 2**20, velocity, rtol=0.0, atol=0.5001 * amplitude / 2**20)
    np.testing.assert_array_equal(quantise(counts * (amplitude * RESOLUTION), amplitude), counts)


def test_what_is_no_velocity_is_a_largest_count() -> None:
    """Neither what is not finite nor what is far above any wave turns over into a small one."""
    with np.errstate(invalid="ignore"):
        counts = quantise(np.array([np.nan, np.inf, -np.inf, 1e9, -1e9, 900.0, -900.0]), 1.0)
    assert counts.tolist() == [2**30] * 5 + [900 * 2**20, -900 * 2**20]


def test_a_stored_section_gives_the_bits_of_a_live_one() -> None:
    """What is read hangs on the integers alone, not on their layout in memory."""
    live = section(total(wave(8.0), wave(4.0, 0.3)), wave(4.0, 0.9))
    stored = replace(live, across=np.asfortranarray(live.across), along=np.frombuffer(live.along.tobytes(), np.int32))
    stored = replace(stored, along=stored.along.reshape(live.along.shape))
    one, other = (read_section(given, 22.0) for given in (live, stored))
    assert isinstance(one, Reading)
    assert isinstance(other, Reading)
    assert one.peak is not None
    assert [one.wave, one.peak, one.first_arrival, one.cross_correlation, one.error, one.bias] == [
        *(other.wave, other.peak, other.first_arrival, other.cross_correlation, other.error, other.bias)
    ]


def test_a_section_knows_when_its_samples_were_taken() -> None:
    """Times, duration, the pulse's period and its peak, and what was transmitted and received."""
    given = section(wave(8.0, 0.25), samples=25, duration=12.0)
    interval = 1.0 / (25.0 * FREQUENCY)
    np.testing.assert_allclose(given.times, (0.3 + np.arange(300)) * interval, rtol=1e-12)
    assert given.duration == pytest.approx(12.0 / FREQUENCY, rel=1e-12)
    assert given.period == pytest.approx(25.0, rel=1e-12)
    assert given.transmitted_peak == pytest.approx(12.2, rel=1e-12)
    assert given.distance == given.places[-1] == 0.094
    np.testing.assert_array_equal(given.transmitted, Pulse(AMPLITUDE, FREQUENCY).velocity(given.times))
    assert given.received.max() == pytest.approx(0.25 * AMPLITUDE, rel=0.01)
    first = given.until(100)
    assert len(first.across) == len(first.along) == 100
    np.testing.assert_array_equal(first.across, given.across[:100])
    assert first.places == given.places


def lattice(columns: int) -> tuple[Packing, WaveRule]:
    """Twelve rows of disks, and a rule that lets the last two columns listen."""
    x, y = hexagonal(columns, 12, 2.0 * RADIUS)
    x, y = x + RADIUS, y + RADIUS
    box = (float(x.max() + 1.01 * RADIUS), float(y.max() + RADIUS))
    packing = bare_packing(x, y, np.full(len(x), RADIUS), np.zeros((0, 2), dtype=int), box)
    return packing, WaveRule(receiver_half_width=6.0 * RADIUS, listening_depth=4.0 * RADIUS, boundary_thickness=0.0)


@pytest.mark.parametrize(("columns", "stations"), [(60, 9), (9, 6)])
def test_nine_stations_stand_on_the_path(columns: int, stations: int) -> None:
    """Slices of one thickness, at least that of a disk, from an eighth of the width on to what listens."""
    packing, rule = lattice(columns)
    found = station_disks(packing, rule)
    assert len(found) == stations
    edges = np.linspace(packing.width / 8.0, packing.width - rule.listening_depth, stations + 1)
    for disks, low, high in zip(found, edges[:-1], edges[1:], strict=True):
        assert len(disks)
        assert high - low >= 2.0 * RADIUS
        assert ((packing.x[disks] >= low) & (packing.x[disks] < high)).all()
        assert (np.abs(packing.y[disks] - packing.height / 2.0) < rule.receiver_half_width).all()
    assert not set(np.concatenate(found).tolist()) & set(listening_disks(packing, rule).tolist())


@pytest.mark.parametrize(("layer", "receiver", "highest"), [(0.0, 9.0, 2.5), (2.5, 9.0, 1.5), (0.0, 2.0, 0.5)])
def test_stations_stand_where_the_wave_is(layer: float, receiver: float, highest: float) -> None:
    """As high as the receiver, at most the middle half of the strip between the layers, 21 or 16 radii high here."""
    packing, rule = lattice(60)
    changed = replace(rule, receiver_half_width=receiver * RADIUS, boundary_thickness=layer * RADIUS)
    off_centre = np.abs(packing.y - packing.height / 2.0)[np.concatenate(station_disks(packing, changed))]
    assert off_centre.max() == pytest.approx(highest * np.sqrt(3.0) * RADIUS)  # rows are the root of 3 apart


def test_there_are_no_stations_where_one_would_be_empty() -> None:
    """A gap in the sample leaves the receiver alone."""
    packing, rule = lattice(60)
    there = np.abs(packing.x - 0.5 * packing.width) > 0.1 * packing.width
    assert station_disks(replace(packing, x=packing.x[there], y=packing.y[there]), rule) == ()
