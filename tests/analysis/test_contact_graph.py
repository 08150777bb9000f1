import itertools
from collections.abc import Callable

import networkx as nx
import numpy as np
import pytest
from numpy.typing import NDArray

from calcidem.analysis.packing_graph import ContactGraph, ContactWeights, ShortestPaths, connectivity, contacts_on_path

Sample = tuple[ContactGraph, NDArray[np.bool_]]
PHYSICAL = ContactWeights(0.475, 0.328)


def length_of(path_weights: ContactWeights, sample: Sample) -> float:
    """Give the length of the preferential path of a sample."""
    path = ShortestPaths.search(*sample, path_weights).first()
    return connectivity(path.hertz_contacts, path.bonded_contacts, path_weights)


def test_the_drawn_path_runs_along_the_cement(drawn_sample: Sample) -> None:
    """In the drawing the path is 5 6 7 8 9, cemented but for the third contact."""
    path = ShortestPaths.search(*drawn_sample, ContactWeights.from_ratio(0.5)).first()
    assert path.grains == (5, 6, 7, 8, 9)
    assert path.bonded == (True, True, False, True)
    assert (path.hertz_contacts, path.bonded_contacts) == (1, 3)


@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.99])
def test_contacts_are_counted_as_on_the_path(drawn_sample: Sample, ratio: float) -> None:
    """The counts alone are those of the path."""
    weights = ContactWeights.from_ratio(ratio)
    graph, drawn = drawn_sample
    for bonded in (drawn, np.ones_like(drawn)):
        path = ShortestPaths.search(graph, bonded, weights).first()
        counted = contacts_on_path(graph, bonded, weights)
        assert connectivity(*counted, weights) == connectivity(path.hertz_contacts, path.bonded_contacts, weights)
        assert counted == (path.hertz_contacts, path.bonded_contacts)


def test_without_cement_the_lowest_numbered_of_equal_paths_is_taken(drawn_sample: Sample) -> None:
    """With no contact cemented both rows are four contacts long, and the upper one has the lower numbers."""
    graph, bonded = drawn_sample
    assert ShortestPaths.search(graph, np.zeros_like(bonded), PHYSICAL).first().grains == (0, 1, 2, 3, 4)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.83, 1.0])
def test_search_finds_the_shortest_of_all_paths(
    seed: int,
    ratio: float,
    random_sample: Callable[..., Sample],
    naive_shortest_paths: Callable[..., list[tuple[int, ...]]],
) -> None:
    """Where every path can be listed, the found one is the first in numbering among the shortest."""
    graph, bonded = random_sample(seed, 11)
    weights = ContactWeights.from_ratio(ratio)
    assert ShortestPaths.search(graph, bonded, weights).first().grains == min(
        naive_shortest_paths(graph, bonded, weights)
    )


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("ratio", [0.5, 0.83, 1.0])
def test_the_longest_run_is_the_mean_over_all_shortest_paths(
    seed: int,
    ratio: float,
    random_sample: Callable[..., Sample],
    naive_shortest_paths: Callable[..., list[tuple[int, ...]]],
) -> None:
    """Where every path can be listed, each of the equally short ones counts once."""
    graph, bonded = random_sample(seed, 16)
    weights = ContactWeights.from_ratio(ratio)
    kinds = {tuple(pair): kind for pair, kind in zip(graph.pairs.tolist(), bonded.tolist(), strict=True)}
    runs = []
    for path in naive_shortest_paths(graph, bonded, weights):
        steps = "".join("b" if kinds[min(pair), max(pair)] else " " for pair in itertools.pairwise(path))
        runs.append(max((len(run) for run in steps.split()), default=0))
    found = ShortestPaths.search(graph, bonded, weights).mean_longest_bonded_run()
    assert found == pytest.approx(np.mean(runs), rel=1e-12)


def test_paths_do_not_depend_on_the_unit_of_the_weights(random_sample: Callable[..., Sample]) -> None:
    """Weights that are far smaller give the same path."""
    sample = random_sample(2, 400)
    small = ContactWeights(3e-5 * PHYSICAL.hertz, 3e-5 * PHYSICAL.bond)
    path = ShortestPaths.search(*sample, PHYSICAL).first()
    assert ShortestPaths.search(*sample, small).first() == path


def test_the_longest_run_does_not_depend_on_the_numbers_of_the_grains(random_sample: Callable[..., Sample]) -> None:
    """Numbered anew, the same sample may have another path found first, but the same longest run."""
    graph, bonded = random_sample(2, 900)
    runs, found = set(), set()
    for seed in range(10):
        number = np.random.default_rng(seed).permutation(graph.grain_count)
        other = ContactGraph(graph.grain_count, *(number[a] for a in (graph.pairs, graph.transmitter, graph.receiver)))
        paths = ShortestPaths.search(other, bonded, PHYSICAL)
        runs.add(round(paths.mean_longest_bonded_run(), 9))
        found.add(tuple(np.argsort(number)[list(paths.first().grains)].tolist()))
    assert len(found) > 1
    assert len(runs) == 1


@pytest.mark.parametrize("seed", range(8))
def test_sparse_search_agrees_with_networkx(seed: int, random_sample: Callable[..., Sample]) -> None:
    """On random planar graphs of 400 grains the length is the one networkx's Dijkstra finds on the model."""
    graph, bonded = random_sample(seed, 400, share=seed / 8)
    model = graph.to_networkx(bonded, PHYSICAL)
    distances = nx.multi_source_dijkstra_path_length(model, set(graph.transmitter.tolist()))
    expected = min(distances[grain] for grain in graph.receiver.tolist())
    assert length_of(PHYSICAL, (graph, bonded)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_the_path_is_a_chain_of_contacts_between_the_lists(seed: int, random_sample: Callable[..., Sample]) -> None:
    """A path touches the transmitter and the receiver only at its ends and knows its cemented contacts."""
    graph, bonded = random_sample(seed, 300)
    path = ShortestPaths.search(graph, bonded, PHYSICAL).first()
    model = graph.to_networkx(bonded, PHYSICAL)
    roles = [model.nodes[grain]["role"] for grain in path.grains]
    assert roles[0] == "transmitter"
    assert roles[-1] == "receiver"
    assert set(roles[1:-1]) <= {"interior"}
    steps = zip(path.grains[:-1], path.grains[1:], strict=True)
    assert tuple(model.edges[step]["bonded"] for step in steps) == path.bonded


def test_the_order_of_contacts_does_not_matter(random_sample: Callable[..., Sample]) -> None:
    """Shuffling the contacts and swapping their ends leaves the path as it is, ties included."""
    graph, bonded = random_sample(3, 300)
    generator = np.random.default_rng(0)
    order = generator.permutation(graph.contact_count)
    shuffled = generator.permuted(graph.pairs[order], axis=1)
    other = ContactGraph(graph.grain_count, shuffled, graph.transmitter[::-1], graph.receiver[::-1])
    assert (
        ShortestPaths.search(other, bonded[order], PHYSICAL).first()
        == ShortestPaths.search(graph, bonded, PHYSICAL).first()
    )


def test_more_cement_never_lengthens_the_path(random_sample: Callable[..., Sample]) -> None:
    """Cementing contacts one group after another makes the weighted path shorter or leaves it."""
    graph, _ = random_sample(5, 400)
    rank = np.random.default_rng(1).permutation(graph.contact_count)
    lengths = [length_of(PHYSICAL, (graph, rank < count)) for count in range(0, graph.contact_count, 100)]
    assert all(after <= before + 1e-12 for before, after in itertools.pairwise(lengths))
    assert lengths[-1] < lengths[0]


def test_coordination_number_counts_every_contact_twice(drawn_sample: Sample) -> None:
    """Thirteen contacts among ten grains make 2.6 contacts a grain."""
    assert drawn_sample[0].coordination_number == pytest.approx(2.6)


def test_the_model_has_every_grain_and_contact(drawn_sample: Sample) -> None:
    """The networkx model of the drawing has 10 vertices and 13 edges, 3 with the weight of cement."""
    model = drawn_sample[0].to_networkx(drawn_sample[1], PHYSICAL)
    assert (model.number_of_nodes(), model.number_of_edges()) == (10, 13)
    cemented = [data["weight"] for *_, data in model.edges(data=True) if data["bonded"]]
    assert cemented == [0.328] * 3


def test_a_gap_between_the_lists_is_refused() -> None:
    """Without a chain of contacts from transmitter to receiver there is no path, and the message says so."""
    graph = ContactGraph(4, np.array([(0, 1), (2, 3)]), np.array([0]), np.array([3]))
    with pytest.raises(ValueError, match="no chain of contacts"):
        ShortestPaths.search(graph, np.array([True, False]), PHYSICAL).first()


@pytest.mark.parametrize(
    ("transmitter", "receiver", "message"),
    [
        ([], [2], "transmitter is empty"),
        ([0], [], "receiver is empty"),
        ([0, 2], [2], "grain 2 is in both transmitter and receiver"),
    ],
)
def test_lists_without_a_path_between_them_are_refused(
    transmitter: list[int], receiver: list[int], message: str
) -> None:
    """Empty and shared lists are named."""
    with pytest.raises(ValueError, match=message):
        ContactGraph(3, np.array([(0, 1), (1, 2)]), np.array(transmitter, dtype=int), np.array(receiver, dtype=int))


def test_a_mask_of_the_wrong_length_is_refused(drawn_sample: Sample) -> None:
    """There is one boolean for each contact."""
    with pytest.raises(ValueError, match="one boolean for each of 13 contacts"):
        ShortestPaths.search(drawn_sample[0], np.array([True]), PHYSICAL).first()
