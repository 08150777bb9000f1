"""Cement as a network between transmitter and receiver: features of a sample, not of one path through it.

A contact counts with the energy of the wave at its height. The wave is that of a strip between the damped layers,
``cos^2(pi y / h)`` with y from mid-height and h the height between the layers.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.sparse.linalg import splu

from calcidem.analysis.contact_graph import ContactGraph
from calcidem.storage.records import NetworkFeatures, PackingRecord

_SAND = 0.01
"""Conductance of a sand contact over that of a cemented one. Their stiffnesses have a ratio of 0.003 to 0.008 in
the preset `paper`. Ratios of 0.003 to 0.1 give the same correlations with Vs (docs/reproduction/conductance.md).
"""

NETWORK_FEATURES = {
    "network_conductance": (
        "G",
        f"current between the side walls over that if all is cemented; a sand contact conducts {_SAND:g} of a bond",
    ),
    "network_cemented_share": ("S", "share of cemented contacts, weighted by the energy of the wave"),
    "network_strong_share": ("S_f", "the same among contacts that carry more than the mean force"),
    "network_coordination_number": ("Z_b", "cemented contacts of a cemented grain"),
    "network_anisotropy": ("A_b", "mean cos(2 angle to the path) of cemented contacts, weighted by energy"),
    "network_components": ("K", "groups of grains joined by cement"),
    "network_largest_component": ("K_max", "grains in the largest of them"),
    "network_gap_contacts": ("N_gap", "fewest sand contacts on a path from transmitter to receiver"),
}
"""Symbol and definition of each of the `NetworkFeatures`."""


@dataclass(frozen=True, eq=False)
class ContactNetwork:
    """Contacts of a packing with what their features need; the cement of a sample is an argument."""

    graph: ContactGraph
    """Contacts (m, 2) of N grains."""
    energy: NDArray[np.float64]
    """(m,) energy of the wave at each contact, 0 in the damped layers."""
    strong: NDArray[np.bool_]
    """(m,) True for contacts above the mean force (Radjai et al. 1998, doi:10.1103/PhysRevLett.80.61)."""
    cosine: NDArray[np.float64]
    """(m,) cos 2a, where a is the angle between contact and path."""
    side: NDArray[np.int8]
    """(N,) -1 for grains that touch the transmitter's wall, 1 for the receiver's, 0 for all others."""

    def features(self, bonded: NDArray[np.bool_]) -> NetworkFeatures:
        """Features of the sample with these cemented contacts (m,)."""
        first, second = self.graph.pairs[bonded].T
        count = self.graph.grain_count
        cement = sparse.coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
        pieces, component = connected_components(cement, directed=False)
        grains = np.bincount(component, minlength=pieces)
        larger = grains[grains > 1]
        bonds = np.bincount(np.concatenate([first, second]), minlength=count)
        conductance, most = self._current(bonded), self._current_if_cemented
        return NetworkFeatures(
            network_conductance=conductance / most if most > 1e-6 else None,  # a billionth leaks to the earth
            network_cemented_share=_mean(bonded, self.energy),
            network_strong_share=_mean(bonded[self.strong], self.energy[self.strong]),
            network_coordination_number=_mean(bonds, bonds > 0),
            network_anisotropy=_mean(self.cosine, self.energy * bonded),
            network_components=len(larger),
            network_largest_component=int(larger.max(initial=0)),
            network_gap_contacts=_fewest_uncemented_contacts(self.graph, bonded, component),
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
        if not free.any():
            return 0.0
        # A weak earth holds groups of grains that touch no wall.
        values = np.concatenate([sums * (1.0 + 1e-9), -conductance])
        matrix, driven = (type(one)((values[one.data], one.indices, one.indptr), one.shape) for one in places)
        factors = splu(
            matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        potential[free] = factors.solve(-np.asarray(driven @ np.ones(driven.shape[1])))
        first, second = pairs.T
        return float(np.sum(conductance * (potential[second] - potential[first]) ** 2))

    @cached_property
    def _equations(self) -> tuple[NDArray[np.bool_], sparse.csc_array, sparse.csr_array]:
        """Grains whose potential is free, and places of the entries of their equations, the same for all samples.

        The second and third are the columns of free grains and of those at the receiver's wall. Their entries number
        the grains, for the diagonal, and then the contacts inside.
        """
        inside, count = self.energy > 0.0, self.graph.grain_count
        first, second = self.graph.pairs[inside].T
        grains, contacts = np.arange(count), count + np.arange(len(first))
        rows, columns = np.concatenate([grains, first, second]), np.concatenate([grains, second, first])
        numbers = np.concatenate([grains, contacts, contacts])
        free = (self.side == 0) & (np.bincount(self.graph.pairs[inside].ravel(), minlength=count) > 0)
        places = sparse.csr_array((numbers, (rows, columns)), shape=(count, count))[free]
        return free, places[:, free].tocsc(), places[:, self.side > 0]


def contact_network(packing: PackingRecord, graph: ContactGraph, boundary_thickness: float) -> ContactNetwork:
    """Network of the contacts of a packing whose layers at floor and lid, so thick (m), are damped."""
    first, second = graph.pairs.T
    branch = np.column_stack([packing.x[second] - packing.x[first], packing.y[second] - packing.y[first]])
    length = np.hypot(*branch.T)
    middle = 0.5 * (packing.y[first] + packing.y[second]) - 0.5 * packing.height
    across = middle / (packing.height - 2.0 * boundary_thickness)
    overlap = np.maximum(packing.radius[first] + packing.radius[second] - length, 0.0)
    radius = packing.radius[first] * packing.radius[second] / (packing.radius[first] + packing.radius[second])
    force = np.sqrt(radius) * overlap**1.5  # Hertz, up to a common factor
    side = (packing.width - packing.x < packing.radius).astype(np.int8) - (packing.x < packing.radius).astype(np.int8)
    return ContactNetwork(
        graph=graph,
        energy=np.where(np.abs(across) < 0.5, np.cos(np.pi * across) ** 2, 0.0),
        strong=force > force.mean(),
        cosine=(branch[:, 0] ** 2 - branch[:, 1] ** 2) / length**2,
        side=side,
    )


def _mean(values: ArrayLike, weight: ArrayLike) -> float | None:
    """Weighted mean; None if nothing has a weight."""
    factors = np.asarray(weight, dtype=np.float64)
    return float(np.average(np.asarray(values, dtype=np.float64), weights=factors)) if factors.any() else None


def _fewest_uncemented_contacts(
    graph: ContactGraph, bonded: NDArray[np.bool_], piece: NDArray[np.integer]
) -> int | None:
    """Return the fewest uncemented contacts on a path from transmitter to receiver; None without any path.

    ``piece`` (N,) numbers the groups of grains joined by cement. Steps within a group cost nothing, so the path leads
    from group to group. It begins at an additional piece, connected only to those of the transmitter.
    """
    begin = int(piece.max()) + 1
    first, second = piece[graph.pairs[~bonded]].T
    sent = piece[graph.transmitter]
    rows, columns = np.concatenate([first, second, np.full(len(sent), begin)]), np.concatenate([second, first, sent])
    ways = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(begin + 1, begin + 1))
    order, before = breadth_first_order(ways, begin)
    heard = order[np.isin(order, piece[graph.receiver])]
    if not len(heard):
        return None
    place, contacts = int(before[heard[0]]), 0
    while place != begin:
        place, contacts = int(before[place]), contacts + 1
    return contacts
