"""Shared by the tests of calcidem.analysis: graphs to search, and the slow, obvious twin of the search."""

import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.packing_graph import ContactGraph, ContactWeights
from calcidem.app.campaign.opened import open_campaign

Sample = tuple[ContactGraph, NDArray[np.bool_]]


@pytest.fixture(scope="session")
def analysis(small_database: Path) -> Iterator[CampaignAnalysis]:
    """Analysis of the small campaign."""
    with open_campaign(small_database) as campaign:
        yield campaign.analyse()


@pytest.fixture
def random_sample() -> Callable[..., Sample]:
    """Give a function (seed, grains, bonded share) that makes a random graph and cements part of it.

    Grains lie near the points of a square lattice of side one and touch their near neighbours, so the graph
    is planar and connected like a packing; the column at the left transmits, that at the right receives. The
    number of grains is rounded down to a square.
    """

    def make(seed: int, grains: int, share: float = 0.4) -> Sample:
        generator = np.random.default_rng(seed)
        side = math.isqrt(grains)
        column, row = np.divmod(np.arange(side**2), side)
        positions = np.stack([column, row], axis=1) + generator.uniform(-0.3, 0.3, (side**2, 2))
        triangles = Delaunay(positions).simplices
        sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [0, 2]]])
        pairs = np.unique(np.sort(sides, axis=1), axis=0)
        distance = np.linalg.norm(np.diff(positions[pairs], axis=1)[:, 0], axis=1)
        # Lattice neighbours are at most hypot(1.6, 0.6) = 1.71 apart, so the shortest spanning tree, which is
        # part of Delaunay's triangles, stays.
        pairs = pairs[distance < 1.75]
        graph = ContactGraph(side**2, pairs, np.flatnonzero(column == 0), np.flatnonzero(column == side - 1))
        return graph, generator.uniform(size=len(pairs)) < share

    return make


@pytest.fixture
def drawn_sample() -> Sample:
    """Give a sample that can be counted by eye.

    Sand contacts are single lines, cemented ones double; 0 and 5 transmit, 4 and 9 receive::

        0 -- 1 -- 2 -- 3 -- 4
        |    |    |    |    |
        5 == 6 == 7 -- 8 == 9

    The straight ways are four sand contacts above, and three cemented contacts and a sand contact below.
    """
    pairs = [
        (0, 1),
        (1, 2),
        (2, 3),
        (3, 4),
        (0, 5),
        (1, 6),
        (2, 7),
        (3, 8),
        (4, 9),
        (5, 6),
        (6, 7),
        (7, 8),
        (8, 9),
    ]
    cemented = {(5, 6), (6, 7), (8, 9)}
    graph = ContactGraph(10, np.array(pairs), np.array([0, 5]), np.array([4, 9]))
    return graph, np.array([pair in cemented for pair in pairs])


@pytest.fixture
def naive_paths() -> Callable[[ContactGraph], Iterator[tuple[int, ...]]]:
    """Give a function that lists every path without loops from a transmitter grain to a receiver grain."""

    def paths(graph: ContactGraph) -> Iterator[tuple[int, ...]]:
        neighbours: dict[int, set[int]] = {grain: set() for grain in range(graph.grain_count)}
        for first, second in graph.pairs.tolist():
            neighbours[first].add(second)
            neighbours[second].add(first)

        def extend(path: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
            if path[-1] in graph.receiver:
                yield path
                return
            for grain in sorted(neighbours[path[-1]].difference(path)):
                yield from extend((*path, grain))

        for start in graph.transmitter.tolist():
            yield from extend((start,))

    return paths


@pytest.fixture
def path_length() -> Callable[..., float]:
    """Give a function that adds up the weights along a path of grains."""

    def length(
        graph: ContactGraph, bonded: NDArray[np.bool_], weights: ContactWeights, grains: tuple[int, ...]
    ) -> float:
        kinds = {frozenset(pair): kind for pair, kind in zip(graph.pairs.tolist(), bonded.tolist(), strict=True)}
        steps = (frozenset(pair) for pair in itertools.pairwise(grains))
        return sum(weights.bond if kinds[step] else weights.hertz for step in steps)

    return length


@pytest.fixture
def naive_shortest_paths(
    naive_paths: Callable[[ContactGraph], Iterator[tuple[int, ...]]], path_length: Callable[..., float]
) -> Callable[..., list[tuple[int, ...]]]:
    """Give a function (graph, bonded, weights) that lists the shortest of all paths, equally long ones together."""

    def shortest(graph: ContactGraph, bonded: NDArray[np.bool_], weights: ContactWeights) -> list[tuple[int, ...]]:
        lengths = {path: path_length(graph, bonded, weights, path) for path in naive_paths(graph)}
        least = min(lengths.values())
        return [path for path, length in lengths.items() if length <= least * (1 + 1e-9)]

    return shortest


@pytest.fixture
def within_binomial() -> Callable[[int, int, float], bool]:
    """Give a function (hits, trials, probability) that says whether a coverage is as promised.

    Four standard deviations of the binomial distribution: a right interval fails once in 16,000 tests, and
    numbers are drawn from fixed seeds, so a test that passes goes on passing.
    """

    def fits(hits: int, trials: int, probability: float) -> bool:
        return abs(hits - trials * probability) <= 4 * np.sqrt(trials * probability * (1 - probability))

    return fits
