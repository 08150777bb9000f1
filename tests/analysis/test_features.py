from collections import Counter
from dataclasses import fields
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.packing_graph import (
    FEATURES,
    ContactGraph,
    ContactWeights,
    PackingGraph,
    PreferentialPath,
    ShortestPaths,
)
from calcidem.storage.records import PathFeatures

WEIGHTS = ContactWeights.from_ratio(0.5)


def features_of(paths: ShortestPaths, graph: ContactGraph, straight: float) -> PathFeatures:
    """Give the features of paths of a graph, which need neither disks nor a network."""
    disks_and_network: Any = [None] * 5
    return PackingGraph(disks_and_network[0], graph, WEIGHTS, straight, *disks_and_network[1:]).features(paths)


def test_features_of_the_drawn_path(drawn_sample: tuple[ContactGraph, NDArray[np.bool_]]) -> None:
    """The drawing's path has 4 contacts, cement on 3 of them and on 2 in a row, and is straight."""
    paths = ShortestPaths.search(*drawn_sample, WEIGHTS)
    path = paths.first()
    found = features_of(paths, drawn_sample[0], 4.0)
    assert path.grains == (5, 6, 7, 8, 9)
    assert (found.path_contacts, found.path_hertz_contacts, found.path_bonded_contacts) == (4, 1, 3)
    assert found.path_bonded_fraction == 3 / 4
    assert found.path_longest_bonded_run == 2
    assert found.path_longest_bonded_run_fraction == 2 / 4
    assert found.path_connectivity == pytest.approx(1 + 3 * 0.5)
    assert found.path_normalized_connectivity == pytest.approx(1 / 4)  # one of four contacts is sand


def test_each_feature_is_defined_once() -> None:
    """The eight definitions are the eight fields of the record, each with its own symbol and words."""
    assert FEATURES.keys() == {field.name for field in fields(PathFeatures)}
    assert [len(set(column)) for column in zip(*FEATURES.values(), strict=True)] == [8, 8]


@given(bonded=st.lists(st.booleans(), min_size=1, max_size=60))
@settings(deadline=None)
def test_features_of_any_path_fit_together(bonded: list[bool]) -> None:
    """Counts add up, shares lie in [0, 1], and the longest run of a chain is its longest word as text."""
    path = PreferentialPath(tuple(range(len(bonded) + 1)), tuple(bonded))
    chain = ContactGraph(
        len(path.grains), np.array(list(pairwise(path.grains))), np.array([0]), np.array([len(bonded)])
    )
    paths = ShortestPaths.search(chain, bonded, WEIGHTS)
    assert paths.first() == path
    found = features_of(paths, chain, 39.0)
    text = "".join("b" if kind else " " for kind in bonded)
    assert found.path_longest_bonded_run == max((len(run) for run in text.split()), default=0)
    assert found.path_contacts == found.path_hertz_contacts + found.path_bonded_contacts == len(bonded)
    assert 0 <= found.path_longest_bonded_run_fraction <= found.path_bonded_fraction <= 1


def test_the_sample_without_cement_counts_once(analysis: CampaignAnalysis) -> None:
    """Tables, laws and pictures have one sample at 0 %, those of a seed at every other content."""
    counts = Counter(sample.content for sample in analysis.samples)
    assert counts.pop(0.0) == 1
    assert max(counts.values()) == analysis.vs.sizes["seed"]
    assert int(analysis.table["path_contacts"].sel(content=0.0).notnull().sum()) == 1
