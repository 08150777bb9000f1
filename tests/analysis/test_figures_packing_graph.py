"""The contact graph of a stored packing, and the products of a whole campaign."""

from itertools import pairwise

import numpy as np
import pytest

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.packing_graph import packing_graph
from calcidem.app.campaign.packing import stored_packing
from calcidem.storage.records import CementPattern


def test_contacts_of_the_graph_are_those_of_the_packing(analysis: CampaignAnalysis) -> None:
    """Found again from positions and radii, the contacts are those that the packing was made with."""
    made = np.sort(stored_packing(analysis.store.packing()).pairs, axis=1)
    found = analysis.graphs[0].graph.pairs
    assert {tuple(pair) for pair in made.tolist()} == {tuple(pair) for pair in found.tolist()}


def test_a_straight_row_spans_the_width_with_median_grains(analysis: CampaignAnalysis) -> None:
    """So many grains of the median diameter by count have one contact fewer."""
    graph = analysis.graphs[0]
    assert (graph.straight + 1) * 2 * np.median(graph.packing.radius) == pytest.approx(graph.packing.width)


def test_paths_end_at_grains_that_touch_the_bands(analysis: CampaignAnalysis) -> None:
    """Each path starts at a grain pressed to the left wall in its band and ends at one at the right wall."""
    packing = analysis.store.packing()
    for sample in analysis.samples:
        first, last = sample.path.grains[0], sample.path.grains[-1]
        assert packing.x[first] < packing.radius[first]
        assert abs(packing.y[first] - packing.height / 2) < 0.01
        assert packing.width - packing.x[last] < packing.radius[last]
        assert abs(packing.y[last] - packing.height / 2) < 0.012


def test_cement_of_the_samples_is_what_the_cells_report(analysis: CampaignAnalysis) -> None:
    """The kinds of contacts add up to the numbers of P and C contacts stored with each cell."""
    for sample in analysis.samples:
        cell = analysis.cells.sel(seed=sample.seed, content=sample.content)
        assert np.count_nonzero(sample.kinds == 1) == int(cell["p_contacts"])
        assert np.count_nonzero(sample.kinds == 2) == int(cell["c_contacts"])


def test_stored_features_give_the_same_as_a_search(analysis: CampaignAnalysis) -> None:
    """The stored path and features equal those of a search."""
    graph = analysis.graphs[0]
    for sample in analysis.samples[::5]:
        bonded = sample.kinds > 0
        again = graph.path(bonded, sample.path.grains)
        assert again == sample.path == graph.path(bonded)
        assert graph.features(graph.shortest_paths(bonded)) == sample.features


def test_path_contacts_are_cemented_where_the_sample_is(analysis: CampaignAnalysis) -> None:
    """Each step of a path is a contact, and its flag says whether the sample has cement there."""
    sample = analysis.samples[-2]
    pairs = [tuple(pair) for pair in analysis.graphs[0].graph.pairs.tolist()]
    for step, bonded in zip(pairwise(sample.path.grains), sample.path.bonded, strict=True):
        assert bool(sample.kinds[pairs.index(tuple(sorted(step)))]) is bonded


def test_pattern_of_another_packing_is_refused(analysis: CampaignAnalysis) -> None:
    """Cement between grains that do not touch names both grains."""
    far = CementPattern(np.array([[0, 1], [2, 0]]), np.array([1, 1]), np.zeros((0, 2)))
    graph = analysis.graphs[0]
    assert (0, 1) not in {tuple(pair) for pair in graph.graph.pairs.tolist()}
    with pytest.raises(ValueError, match="grains 0 and 1 are joined in the pattern but do not touch"):
        graph.kinds(far)


def test_band_without_grains_is_refused(analysis: CampaignAnalysis) -> None:
    """A band too narrow for any grain has no transmitter."""
    with pytest.raises(ValueError, match="transmitter is empty"):
        packing_graph(analysis.store.packing(), 1e-6, 0.012, 0.01)


def test_missing_and_failed_cells_are_told_apart(analysis: CampaignAnalysis) -> None:
    """A cell that was not computed has no status, one that failed has its own."""
    assert analysis.status.sel(seed=6, content=0.34).item() == ""
    assert analysis.status.sel(seed=6, content=9.0).item() == "failed"
    assert sum(row.missing for row in analysis.distributions) == 1
    known = np.isfinite(analysis.vs.to_numpy())
    assert sum(row.vs.n for row in analysis.distributions) == known.sum()
