"""A pattern of cement and a feature of a sample for calcidem: cement that settles from above."""

import numpy as np

from calcidem.analysis.packing_graph import PackingGraph


def layers(points: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Order of the contacts with these points (M, 2), m: from the floor up, in layers of 3 mm."""
    return np.lexsort((generator.permutation(len(points)), np.floor(points[:, 1] / 3e-3)))


def cemented_below(graph: PackingGraph, kinds: np.ndarray) -> float:
    """Share of cemented contacts below the middle of the sample."""
    height = graph.packing.y[graph.graph.pairs].mean(axis=1)
    return float(np.mean(kinds[height < graph.packing.height / 2] > 0))
