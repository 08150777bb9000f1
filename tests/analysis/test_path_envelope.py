import itertools
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from calcidem.analysis import correlation as module
from calcidem.analysis.correlation import PathEnvelope, _PathLine, path_envelope
from calcidem.analysis.packing_graph import ContactGraph, ContactWeights, ShortestPaths, connectivity, contacts_on_path

Sample = tuple[ContactGraph, NDArray[np.bool_]]


def detour(sand: int, cemented: int) -> Sample:
    """Make two separate ways from grain 0 to grain 1: one of sand contacts, a longer one of cemented ones."""
    upper = [0, *range(2, 1 + sand), 1]
    lower = [0, *range(1 + sand, sand + cemented), 1]
    pairs = [*itertools.pairwise(upper), *itertools.pairwise(lower)]
    graph = ContactGraph(sand + cemented, np.array(pairs), np.array([0]), np.array([1]))
    return graph, np.array([False] * sand + [True] * cemented)


def corners_of(envelope: PathEnvelope) -> list[float]:
    """Give the ratios at which one path takes over from the one before."""
    return [
        (after.hertz_contacts - before.hertz_contacts) / (before.bonded_contacts - after.bonded_contacts)
        for before, after in itertools.pairwise(envelope.lines)
    ]


def test_corner_of_a_detour() -> None:
    """A way of 6 cemented contacts beats one of 3 sand contacts as long as 6 r < 3."""
    envelope = path_envelope(*detour(3, 6))
    assert envelope.lines == (_PathLine(0, 6), _PathLine(3, 0))
    assert corners_of(envelope) == [0.5]
    np.testing.assert_allclose(envelope.connectivity([0.25, 0.5, 0.75]), [1.5, 3.0, 3.0])


@pytest.mark.parametrize("seed", range(6))
def test_envelope_is_the_plain_scan(seed: int, random_sample: Callable[..., Sample]) -> None:
    """At every ratio of a plain scan the envelope has the length that a search at that ratio finds."""
    graph, bonded = random_sample(seed, 800, share=0.05 + 0.15 * seed)
    ratios = np.linspace(0.01, 0.99, 50)
    envelope = path_envelope(graph, bonded)
    plain = []
    for ratio in ratios:
        weights = ContactWeights.from_ratio(ratio)
        path = ShortestPaths.search(graph, bonded, weights).first()
        plain.append(connectivity(path.hertz_contacts, path.bonded_contacts, weights))
    np.testing.assert_allclose(envelope.connectivity(ratios), plain, rtol=1e-12)


def test_random_samples_have_several_corners(random_sample: Callable[..., Sample]) -> None:
    """A sample with scattered cement has three corners or more, so comparing it means something."""
    assert len(corners_of(path_envelope(*random_sample(1, 800, share=0.2)))) >= 3


@pytest.mark.parametrize("seed", range(6))
def test_paths_take_over_in_order(seed: int, random_sample: Callable[..., Sample]) -> None:
    """Along the ratio, paths lose cemented and gain sand contacts, at ascending corners in the range."""
    envelope = path_envelope(*random_sample(seed, 600, share=0.3))
    corners = np.array(corners_of(envelope))
    hertz, bond = np.array(envelope.lines).T
    assert (np.diff(hertz) > 0).all()
    assert (np.diff(bond) < 0).all()
    assert (np.diff(corners) > 0).all()
    assert ((corners > 0.01) & (corners < 0.99)).all()


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_sample_of_one_kind_has_one_path(share: float, random_sample: Callable[..., Sample]) -> None:
    """With no contact or every contact cemented, the same number of contacts is shortest at every ratio."""
    graph, _ = random_sample(2, 300)
    envelope = path_envelope(graph, np.full(graph.contact_count, bool(share)))
    assert len(envelope.lines) == 1
    assert corners_of(envelope) == []


def test_few_searches_are_needed(random_sample: Callable[..., Sample], monkeypatch: pytest.MonkeyPatch) -> None:
    """An envelope of k paths takes at most 2 k + 1 searches: one a path, one a corner, two at the ends."""
    searches = 0

    def counted(*arguments: object) -> object:
        nonlocal searches
        searches += 1
        return contacts_on_path(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "contacts_on_path", counted)
    envelope = path_envelope(*random_sample(1, 800, share=0.2))
    assert searches <= 2 * len(envelope.lines) + 1
