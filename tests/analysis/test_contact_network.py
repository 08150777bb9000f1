"""Features of cement as a network, on networks that can be solved by hand or by dense matrices."""

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.packing_graph import NETWORK_FEATURES, ContactGraph, ContactWeights, PackingGraph, packing_graph
from calcidem.storage.records import NetworkFeatures

DISKS: Any = SimpleNamespace(index=0)  # no feature of the network looks at them

# Two rows of four grains between the walls, and one grain (8) that touches nothing:
#   0 - 1 - 2 - 3
#   |           |
#   4 - 5 - 6 - 7
PAIRS = np.array([(0, 1), (1, 2), (2, 3), (0, 4), (3, 7), (4, 5), (5, 6), (6, 7)])


def packing_with(graph: ContactGraph, *arrays: np.ndarray) -> PackingGraph:
    """Contacts with energy, strong, cosine and side; nothing depends on the disks."""
    return PackingGraph(DISKS, graph, ContactWeights(1.0, 0.5), 1.0, *arrays)


def network(pairs: np.ndarray = PAIRS, energy: np.ndarray | None = None) -> PackingGraph:
    """Network of some contacts; the ends of both rows touch the walls."""
    graph = ContactGraph(9, pairs, np.array([0, 4]), np.array([3, 7]))
    strong, cosine = np.arange(len(pairs)) % 2 == 0, np.linspace(-1.0, 1.0, len(pairs))
    side = np.array([-1, 0, 0, 1, -1, 0, 0, 1, 0], dtype=np.int8)
    return packing_with(graph, np.ones(len(pairs)) if energy is None else energy, strong, cosine, side)


def bonded(*contacts: tuple[int, int]) -> np.ndarray:
    """Mark contacts as cemented."""
    return np.array([tuple(pair) in contacts for pair in PAIRS.tolist()])


def test_every_feature_has_a_symbol_and_a_definition() -> None:
    """The catalogue has the fields of the record."""
    assert list(NETWORK_FEATURES) == [field.name for field in fields(NetworkFeatures)]
    assert all(len(set(column)) == len(NETWORK_FEATURES) for column in zip(*NETWORK_FEATURES.values(), strict=True))


def test_sand_alone() -> None:
    """Sand conducts a hundredth of cement; there are no groups, and the straight way has three sand contacts."""
    found = network().network_features(bonded())
    assert found.network_conductance == pytest.approx(0.01, rel=1e-6)
    assert (found.network_coordination_number, found.network_anisotropy) == (None, None)
    assert (found.network_components, found.network_largest_component, found.network_gap_contacts) == (0, 0, 3)


def test_contacts_conduct_as_the_wave_has_energy_there() -> None:
    """A cemented row whose middle has a twentieth of the energy: 1/1 + 20/1 + 1/1 beside 3/.01 of sand."""
    found = network(energy=np.where(np.arange(len(PAIRS)) == 1, 0.05, 1.0)).network_features(
        bonded((0, 1), (1, 2), (2, 3))
    )
    most = 1.0 / 22.0 + 1.0 / 3.0
    assert found.network_conductance == pytest.approx((1.0 / 22.0 + 0.01 / 3.0) / most, rel=1e-6)


def test_resistors_in_series_and_in_parallel() -> None:
    """Two rows of three contacts: that with two of three cemented has 1/1 + 1/1 + 1/.01, the bare one 3/.01."""
    found = network().network_features(bonded((0, 1), (1, 2), (6, 7)))
    rows = 1.0 / (2.0 + 100.0) + 1.0 / (1.0 + 200.0)
    assert found.network_conductance == pytest.approx(rows / (2.0 / 3.0), rel=1e-6)
    assert found.network_cemented_share == 3.0 / 8.0
    assert found.network_strong_share == 1.0 / 4.0  # of contacts 0, 2, 4, 6
    assert found.network_coordination_number == (1 + 2 + 1 + 1 + 1) / 5
    assert found.network_anisotropy == pytest.approx(np.linspace(-1.0, 1.0, 8)[[0, 1, 7]].mean())
    assert (found.network_components, found.network_largest_component, found.network_gap_contacts) == (2, 3, 1)


def test_cement_from_end_to_end_leaves_no_gap() -> None:
    """A row that is cemented through has a gap of 0, though the other row is bare."""
    found = network().network_features(bonded((4, 5), (5, 6), (6, 7)))
    assert (found.network_components, found.network_largest_component, found.network_gap_contacts) == (1, 4, 0)
    assert found.network_conductance == pytest.approx(1.01 / 2.0, rel=1e-6)


def test_no_way_is_no_gap_and_no_current() -> None:
    """Where no chain of contacts joins both walls, nothing is defined."""
    found = network(np.array([(0, 1), (2, 3)])).network_features(np.array([True, False]))
    assert found.network_gap_contacts is None
    assert found.network_conductance is None


def test_contacts_outside_the_wave_do_not_count() -> None:
    """Without energy in the lower row its cement changes nothing."""
    energy = np.where(np.isin(np.arange(8), [0, 1, 2]), 0.5, 0.0)
    upper = bonded((0, 1))
    found = network(energy=energy).network_features(upper)
    assert found.network_conductance == pytest.approx(3.0 / (1.0 + 200.0), rel=1e-6)
    both = network(energy=energy).network_features(upper | bonded((4, 5), (5, 6)))
    assert both.network_conductance == found.network_conductance
    assert both.network_cemented_share == found.network_cemented_share == pytest.approx(1.0 / 3.0)
    nothing = network(energy=np.zeros(8)).network_features(upper)
    assert (nothing.network_conductance, nothing.network_cemented_share) == (None, None)


@given(st.integers(0, 2**31))
def test_current_is_that_of_a_dense_solution_and_never_falls_with_more_cement(seed: int) -> None:
    """Random networks; Rayleigh's monotonicity: no contact that is cemented in addition reduces the current."""
    random = np.random.default_rng(seed)
    grains = 14
    every = np.array([(a, b) for a in range(grains) for b in range(a + 1, grains)])
    pairs = every[random.random(len(every)) < 0.4]
    side = np.array([-1, -1, *[0] * (grains - 4), 1, 1], dtype=np.int8)
    graph = ContactGraph(grains, pairs, np.array([0, 1]), np.array([grains - 2, grains - 1]))
    energy = random.uniform(0.1, 1.0, len(pairs))
    made = packing_with(graph, energy, np.ones(len(pairs), dtype=bool), np.zeros(len(pairs)), side)
    cement = random.random(len(pairs)) < 0.5

    def current(flags: np.ndarray) -> float:
        laplace = np.zeros((grains, grains))
        for (a, b), conducts in zip(pairs.tolist(), np.where(flags, 1.0, 0.01) * energy, strict=True):
            laplace[[a, b], [a, b]] += conducts
            laplace[[a, b], [b, a]] -= conducts
        potential, free = (side > 0).astype(float), side == 0
        potential[free] = np.linalg.lstsq(laplace[np.ix_(free, free)], -(laplace @ potential)[free], rcond=None)[0]
        return float(potential @ laplace @ potential)

    found = made.network_features(cement).network_conductance
    assert found == pytest.approx(current(cement) / current(np.ones(len(pairs), dtype=bool)), rel=1e-5)
    more = made.network_features(cement | (random.random(len(pairs)) < 0.3)).network_conductance
    assert more is not None
    assert found is not None
    assert more >= found * (1.0 - 1e-9)


def test_the_wave_of_a_strip_and_the_forces_of_hertz(analysis: CampaignAnalysis) -> None:
    """Weights of a square lattice between damped layers: cos^2 across, directions, walls, and the larger overlaps."""
    x, y = (values.ravel() for values in np.meshgrid(0.5 + np.arange(6.0), 0.5 + np.arange(10.0)))
    radius = np.where(y > 5.0, 0.51, 0.505)
    packing = replace(analysis.store.packing(), x=x, y=y, radius=radius, width=6.0, height=10.0)
    made = packing_graph(packing, 9.0, 9.0, 2.0)
    pairs = made.graph.pairs
    middle = y[pairs].mean(axis=1) - 5.0
    np.testing.assert_allclose(made.energy, np.where(np.abs(middle) < 3.0, np.cos(np.pi * middle / 6.0) ** 2, 0.0))
    np.testing.assert_allclose(made.cosine, np.where(y[pairs[:, 0]] == y[pairs[:, 1]], 1.0, -1.0))
    np.testing.assert_array_equal(made.strong, y[pairs].min(axis=1) > 5.0)
    np.testing.assert_array_equal(made.side, np.where(x < 1.0, -1, np.where(x > 5.0, 1, 0)))


def test_strong_contacts_carry_more_than_the_mean_force(analysis: CampaignAnalysis) -> None:
    """Hertz forces of disks at random distances, one by one; small disks may be pressed harder than large ones."""
    random = np.random.default_rng(4)
    x, y = (values.ravel() for values in np.meshgrid(0.5 + np.arange(6.0), 0.5 + np.arange(10.0)))
    x, y, radius = (
        x + random.uniform(-0.01, 0.01, 60),
        y + random.uniform(-0.01, 0.01, 60),
        random.uniform(0.5, 0.6, 60),
    )
    made = packing_graph(
        replace(analysis.store.packing(), x=x, y=y, radius=radius, width=6.0, height=10.0), 9.0, 9.0, 2.0
    )
    force = [
        np.sqrt(1.0 / (1.0 / radius[i] + 1.0 / radius[j]))
        * (radius[i] + radius[j] - np.hypot(x[i] - x[j], y[i] - y[j])) ** 1.5
        for i, j in made.graph.pairs
    ]
    np.testing.assert_array_equal(made.strong, force > np.mean(force))
