"""Contact graph of a stored packing, and features of its samples.

Eight describe the preferential path (Fig. 13 of the paper), others the cement as a network between transmitter and
receiver, and packages may add features of their own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import entry_points
from inspect import getdoc
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from calcidem.analysis.contact_graph import (
    ContactGraph,
    ContactWeights,
    PreferentialPath,
    ShortestPaths,
    connectivity,
    normalized_connectivity,
)
from calcidem.storage.records import CementPattern, NetworkFeatures, PackingRecord, PathFeatures

_SAND = 0.01
"""Conductance of a sand contact over that of a cemented one. Their stiffnesses have a ratio of 0.003 to 0.008 in
the preset `paper`. Ratios of 0.003 to 0.1 give the same correlations with Vs (docs/reproduction/conductance.md).
"""

FEATURES, NETWORK_FEATURES = (
    {quantity.name: (quantity.symbol, quantity.meaning) for quantity in kind.quantities()}
    for kind in (PathFeatures, NetworkFeatures)
)
"""Symbol and definition of each of the `PathFeatures` and `NetworkFeatures`, dimensionless; symbols of the former are
those of the paper.
"""


def _factorise(matrix: Any, order: Literal["NATURAL", "MMD_AT_PLUS_A"]) -> Any:  # noqa: ANN401 - types of SciPy
    """LU factors of a symmetric matrix in an order of elimination; its columns have few entries, so they go singly."""
    return splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, panel_size=1, options={"SymmetricMode": True})


def _mean(values: ArrayLike, weight: ArrayLike) -> float | None:
    """Weighted mean; None if nothing has a weight."""
    factors = np.asarray(weight, dtype=np.float64)
    return float(np.average(np.asarray(values, dtype=np.float64), weights=factors)) if factors.any() else None


@dataclass(frozen=True, eq=False)
class PackingGraph:
    """Contacts of a packing, and what features of paths and of cement as a network need."""

    packing: PackingRecord
    """The disks."""
    graph: ContactGraph
    """Contacts, and grains at transmitter and receiver."""
    weights: ContactWeights
    """Weights by their physical meaning (Eq. 8 of the paper), from the coordination number of all grains."""
    straight: float
    """Contacts of a straight row of grains of the median diameter by count, from wall to wall: L / d50 - 1."""
    energy: NDArray[np.float64]
    """(m,) energy of the wave at each contact, 0 in the damped layers."""
    strong: NDArray[np.bool_]
    """(m,) True for contacts above the mean force (Radjai et al. 1998, doi:10.1103/PhysRevLett.80.61)."""
    cosine: NDArray[np.float64]
    """(m,) cos 2a, where a is the angle between contact and path."""
    side: NDArray[np.int8]
    """(N,) -1 for grains that touch the transmitter's wall, 1 for the receiver's, 0 for all others."""

    @cached_property
    def _keys(self) -> NDArray[np.int64]:
        """Numbers of the contacts for fast lookup by patterns."""
        return _contact_keys(self.graph.pairs, self.graph.grain_count)

    def kinds(self, cement: CementPattern) -> NDArray[np.uint8]:
        """Return 0 (sand), 1 (P) or 2 (C) for each contact of the graph, shape (m,).

        `ValueError` if the pattern cements two grains that do not touch.
        """
        kinds = np.zeros(self.graph.contact_count, dtype=np.uint8)
        kinds[self._rows(cement.contacts)] = cement.kind
        return kinds

    def path(self, bonded: NDArray[np.bool_], known: tuple[int, ...] = ()) -> PreferentialPath:
        """Return the preferential path of a sample with these cemented contacts (m,); known grains save the search.

        `ValueError` if no chain of contacts joins transmitter and receiver.
        """
        if not known:
            return self.shortest_paths(bonded).first()
        flags = bonded[self._rows(np.array(list(pairwise(known))))]
        return PreferentialPath(known, tuple(flags.tolist()))

    def shortest_paths(self, bonded: NDArray[np.bool_]) -> ShortestPaths:
        """Search the shortest paths of one sample; argument and errors as for `path`."""
        return ShortestPaths.search(self.graph, bonded, self.weights)

    def features(self, paths: ShortestPaths) -> PathFeatures:
        """Return the features of the shortest paths of one sample, of at least one contact."""
        path, longest = paths.first(), paths.mean_longest_bonded_run()
        contacts, c_d = len(path.bonded), connectivity(path.hertz_contacts, path.bonded_contacts, self.weights)
        return PathFeatures(
            path_contacts=contacts,
            path_hertz_contacts=path.hertz_contacts,
            path_bonded_contacts=path.bonded_contacts,
            path_bonded_fraction=path.bonded_contacts / contacts,
            path_longest_bonded_run_fraction=longest / contacts,
            path_longest_bonded_run=longest,
            path_connectivity=c_d,
            path_normalized_connectivity=normalized_connectivity(c_d, self.weights, self.straight),
        )

    def network_features(self, bonded: NDArray[np.bool_]) -> NetworkFeatures:
        """Return the features of the cement of one sample as a network; cemented contacts (m,)."""
        first, second = self.graph.pairs[bonded].T
        count = self.graph.grain_count
        cement = sparse.coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
        pieces, component = connected_components(cement, directed=False)
        grains = np.bincount(component, minlength=pieces)
        larger = grains[grains > 1]
        bonds = np.bincount(np.concatenate([first, second]), minlength=count)
        conductance, most = self._current(bonded), self._current_if_cemented
        steps = self.graph.with_entries(np.where(bonded, 0.0, 1.0)[self.graph.entry_contacts])
        fewest = dijkstra(steps, indices=self.graph.transmitter, min_only=True)[self.graph.receiver].min()
        return NetworkFeatures(
            network_conductance=conductance / most if most > 1e-6 else None,  # a billionth leaks to the earth
            network_cemented_share=_mean(bonded, self.energy),
            network_strong_share=_mean(bonded[self.strong], self.energy[self.strong]),
            network_coordination_number=_mean(bonds, bonds > 0),
            network_anisotropy=_mean(self.cosine, self.energy * bonded),
            network_components=len(larger),
            network_largest_component=int(larger.max(initial=0)),
            network_gap_contacts=int(fewest) if np.isfinite(fewest) else None,
        )

    @cached_property
    def _current_if_cemented(self) -> float:
        return self._current(np.ones(self.graph.contact_count, dtype=np.bool_))

    def _current(self, bonded: NDArray[np.bool_]) -> float:
        """Current between the walls at a potential difference of one; contacts conduct as the wave has energy there."""
        inside = self.energy > 0.0
        pairs, conductance = self.graph.pairs[inside], np.where(bonded, 1.0, _SAND)[inside] * self.energy[inside]
        sums = np.bincount(pairs.ravel(), weights=np.repeat(conductance, 2), minlength=self.graph.grain_count)
        potential, (free, *places) = (self.side > 0).astype(float), self._equations
        if not len(free):
            return 0.0
        # A weak earth holds groups of grains that touch no wall.
        values = np.concatenate([sums * (1.0 + 1e-9), -conductance])
        matrix, driven = (type(one)((values[one.data], one.indices, one.indptr), one.shape) for one in places)
        factors = _factorise(matrix, "NATURAL")
        potential[free] = factors.solve(-np.asarray(driven @ np.ones(driven.shape[1])))
        first, second = pairs.T
        return float(np.sum(conductance * (potential[second] - potential[first]) ** 2))

    @cached_property
    def _equations(self) -> tuple[NDArray[np.intp], sparse.csc_array, sparse.csr_array]:
        """Grains whose potential is free, and places of the entries of their equations, the same for all samples.

        The grains are in an order of elimination that fills few entries. The second and third are the columns of free
        grains and of those at the receiver's wall. Their entries number the grains, for the diagonal, and then the
        contacts inside.
        """
        inside, count = self.energy > 0.0, self.graph.grain_count
        first, second = self.graph.pairs[inside].T
        grains, contacts = np.arange(count), count + np.arange(len(first))
        rows, columns = np.concatenate([grains, first, second]), np.concatenate([grains, second, first])
        numbers = np.concatenate([grains, contacts, contacts])
        degree = np.bincount(self.graph.pairs[inside].ravel(), minlength=count)
        free = np.flatnonzero((self.side == 0) & (degree > 0))
        places = sparse.csr_array((numbers, (rows, columns)), shape=(count, count))
        if len(free):
            pattern = sparse.csr_array((np.where(numbers < count, 1.0, -1e-3), (rows, columns)), shape=places.shape)
            free = free[np.argsort(_factorise(pattern[free][:, free].tocsc(), "MMD_AT_PLUS_A").perm_c)]
        return free, places[free][:, free].tocsc(), places[free][:, self.side > 0]

    def _rows(self, pairs: NDArray[np.integer]) -> NDArray[np.int64]:
        """Find the row of each pair in the sorted contacts."""
        wanted = _contact_keys(np.asarray(pairs, dtype=np.int64).reshape(-1, 2), self.graph.grain_count)
        rows = np.minimum(np.searchsorted(self._keys, wanted), len(self._keys) - 1)
        strange = self._keys[rows] != wanted
        if strange.any():
            first = np.asarray(pairs)[strange][0].tolist()
            raise ValueError(
                f"grains {first[0]} and {first[1]} are joined in the pattern but do not touch in packing "
                f"{self.packing.index}; the pattern belongs to another packing"
            )
        return np.asarray(rows, dtype=np.int64)


Feature = Callable[[PackingGraph, NDArray[np.uint8]], float]
"""Feature of a sample, from the graph of its packing and the cement (m,) of its contacts: 0 sand, 1 P, 2 C."""


def installed_features() -> dict[str, Feature]:
    """Features of other packages, the entry points of the group ``calcidem.features``, by name."""
    return {point.name: point.load() for point in entry_points(group="calcidem.features")}


def describe_feature(feature: Feature) -> str:
    """Definition of a feature: the first line of its docstring, or its name."""
    told = getdoc(feature) or str(getattr(feature, "__name__", ""))
    return told.partition("\n")[0].rstrip(".")


def packing_graph(
    packing: PackingRecord, transmitter_half_width: float, receiver_half_width: float, boundary_thickness: float
) -> PackingGraph:
    """Build the graph of a packing.

    Transmitter and receiver grains touch the left and the right wall within a half-width (m) of mid-height. The damped
    layers at floor and lid have a thickness (m). `ValueError` if no grain touches one of the bands.
    """
    off_centre = np.abs(packing.y - packing.height / 2)
    centres = np.column_stack([packing.x, packing.y])
    near = cKDTree(centres).query_pairs(2 * float(packing.radius.max()), output_type="ndarray")
    pairs = np.sort(near.astype(np.int64).reshape(-1, 2), axis=1)
    distance = np.linalg.norm(centres[pairs[:, 1]] - centres[pairs[:, 0]], axis=1)
    touching = pairs[distance < packing.radius[pairs].sum(axis=1)]
    at_transmitter, at_receiver = packing.x < packing.radius, packing.width - packing.x < packing.radius
    graph = ContactGraph(
        grain_count=packing.radius.size,
        pairs=touching[np.lexsort((touching[:, 1], touching[:, 0]))],
        transmitter=np.flatnonzero(at_transmitter & (off_centre < transmitter_half_width)),
        receiver=np.flatnonzero(at_receiver & (off_centre < receiver_half_width)),
    )
    first, second = graph.pairs.T
    branch = np.column_stack([packing.x[second] - packing.x[first], packing.y[second] - packing.y[first]])
    length = np.hypot(*branch.T)
    middle = 0.5 * (packing.y[first] + packing.y[second]) - 0.5 * packing.height
    across = middle / (packing.height - 2.0 * boundary_thickness)
    overlap = np.maximum(packing.radius[first] + packing.radius[second] - length, 0.0)  # below it by rounding
    radius = packing.radius[first] * packing.radius[second] / (packing.radius[first] + packing.radius[second])
    force = np.sqrt(radius) * overlap**1.5  # Hertz, up to a common factor
    return PackingGraph(
        packing=packing,
        graph=graph,
        weights=ContactWeights.from_coordination_number(graph.coordination_number),
        straight=packing.width / (2 * float(np.median(packing.radius))) - 1,
        energy=np.where(np.abs(across) < 0.5, np.cos(np.pi * across) ** 2, 0.0),
        strong=force > force.mean(),
        cosine=(branch[:, 0] ** 2 - branch[:, 1] ** 2) / length**2,
        side=at_receiver.astype(np.int8) - at_transmitter,
    )


def _contact_keys(pairs: NDArray[np.int64], grain_count: int) -> NDArray[np.int64]:
    first, second = pairs.T
    keys: NDArray[np.int64] = np.minimum(first, second) * grain_count + np.maximum(first, second)
    return keys
