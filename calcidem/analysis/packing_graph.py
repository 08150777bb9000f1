"""Contact graph of a stored packing, the preferential path of shear waves in it, and features of its samples.

Grains and contacts are a weighted undirected graph (section 2.4 of the paper). The weighted length of the shortest path
is the connectivity C_d, or normalised C_d,n (Eqs. 8 and 9). Eight features describe this path (Fig. 13), others the
cement as a network between transmitter and receiver, and packages may add features of their own.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from heapq import heapify, heappop, heappush
from importlib.metadata import entry_points
from inspect import getdoc
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from calcidem.storage.records import CementPattern, NetworkFeatures, PackingRecord, PathFeatures

if TYPE_CHECKING:
    import networkx as nx


@dataclass(frozen=True, slots=True)
class ContactWeights:
    """Dimensionless length that a contact of each kind adds to a path.

    Raises
    ------
    ValueError
        If 0 < bond <= hertz does not hold.
    """

    hertz: float
    """Weight of a sand contact, omega_h."""
    bond: float
    """Weight of a cemented contact, omega_LPB; at most that of a sand contact, because cement shortens the path."""

    def __post_init__(self) -> None:
        """Check the order of the weights."""
        if not 0 < self.bond <= self.hertz:
            raise ValueError(f"weights hertz = {self.hertz} and bond = {self.bond} must satisfy 0 < bond <= hertz")

    @classmethod
    def from_coordination_number(cls, coordination_number: float) -> Self:
        """Choose the weights by their physical meaning, Eq. 8: C^(-2/3) for sand, 1/C for cement, C = 2 N_c / N."""
        return cls(hertz=coordination_number ** (-2 / 3), bond=1 / coordination_number)

    @classmethod
    def from_ratio(cls, ratio: float) -> Self:
        """Choose the weights by their ratio omega_LPB / omega_h with omega_h = 1, as in Fig. 14."""
        return cls(hertz=1.0, bond=ratio)

    @property
    def ratio(self) -> float:
        """The ratio omega_LPB / omega_h, in (0, 1]."""
        return self.bond / self.hertz


def connectivity(hertz_contacts: int, bonded_contacts: int, weights: ContactWeights) -> float:
    """Return C_d, the weighted length of a path of N_h sand contacts and N_LPB cemented ones, Eq. 9."""
    return weights.hertz * hertz_contacts + weights.bond * bonded_contacts


def normalized_connectivity(c_d: float, weights: ContactWeights, straight: float) -> float:
    """Return C_d,n, Eq. 9: 0 for a straight row of cemented contacts, 1 for a straight row of sand contacts.

    The weights are those of C_d; ``straight`` is the number of contacts of such a row. `ValueError` for equal weights,
    since the definition divides by their difference.
    """
    if weights.bond == weights.hertz:
        raise ValueError(f"both weights are {weights.hertz}; C_d,n exists only where bond < hertz")
    return (c_d - weights.bond * straight) / ((weights.hertz - weights.bond) * straight)


_RELATIVE_TIE = 1e-9
"""Relative difference below which paths are equally long; round-off is about 1e-14."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactGraph:
    """The contacts of one packing.

    Raises
    ------
    ValueError
        If a list of grains is empty or shares a grain with the other.
    """

    grain_count: int
    """Number of grains N; grains are numbered from 0."""
    pairs: NDArray[np.int64]
    """The two grains of each contact, integers, shape (m, 2); no contact appears twice."""
    transmitter: NDArray[np.int64]
    receiver: NDArray[np.int64]
    """Grains touched by the transmitter and by the receiver, integers, shapes (a,) and (b,), without common grain."""
    _row_starts: NDArray[np.int32] = field(init=False, repr=False)
    _neighbours: NDArray[np.int32] = field(init=False, repr=False)
    entry_contacts: NDArray[np.int64] = field(init=False, repr=False)
    """Contact of each entry of the sparse matrix, integers, shape (2 m,)."""

    def __post_init__(self) -> None:
        """Check the lists and arrange the contacts for searches."""
        pairs = np.asarray(self.pairs, dtype=np.int64).reshape(-1, 2)
        lists = {
            name: np.unique(np.asarray(getattr(self, name), dtype=np.int64)) for name in ("transmitter", "receiver")
        }
        for name, grains in lists.items():
            if not grains.size:
                raise ValueError(f"{name} is empty; name at least one grain")
        if (common := np.intersect1d(lists["transmitter"], lists["receiver"])).size:
            raise ValueError(f"grain {common[0]} is in both transmitter and receiver; the two must be apart")
        # Every contact is stored in both directions, rows and columns ascending. `entry_contacts` maps entries to
        # contacts, so a cell only fills in the weights.
        rows, columns = np.concatenate([pairs, pairs[:, ::-1]]).T
        order = np.lexsort((columns, rows))
        starts = np.searchsorted(rows[order], np.arange(self.grain_count + 1))
        values = {
            "pairs": pairs,
            **lists,
            "_row_starts": starts.astype(np.int32),
            "_neighbours": columns[order].astype(np.int32),
            "entry_contacts": order % max(len(pairs), 1),
        }
        for name, array in values.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def contact_count(self) -> int:
        """Number of contacts m."""
        return len(self.pairs)

    @property
    def coordination_number(self) -> float:
        """Mean number of contacts of a grain, C = 2 m / N, grains without contact included."""
        return 2 * self.contact_count / self.grain_count

    def contact_weights(self, bonded: ArrayLike, weights: ContactWeights) -> NDArray[np.float64]:
        """Return the weight of each contact; ``bonded`` marks cemented ones, both (m,), else `ValueError`."""
        mask = np.asarray(bonded, dtype=np.bool_)
        if mask.shape != (self.contact_count,):
            raise ValueError(
                f"bonded has shape {mask.shape}; give one boolean for each of {self.contact_count} contacts"
            )
        return np.where(mask, weights.bond, weights.hertz)

    def matrix(self, bonded: ArrayLike, weights: ContactWeights) -> sparse.csr_array:
        """Return the symmetric sparse matrix of contact weights, shape (N, N); see `contact_weights`."""
        return self.with_entries(self.contact_weights(bonded, weights)[self.entry_contacts])

    def with_entries(self, values: NDArray[np.float64]) -> sparse.csr_array:
        """Return a sparse matrix (N, N) with a value (2 m,) for each entry; `entry_contacts` are their contacts."""
        return sparse.csr_array(
            (values, self._neighbours, self._row_starts), shape=(self.grain_count, self.grain_count)
        )

    def to_networkx(self, bonded: ArrayLike, weights: ContactWeights) -> "nx.Graph[int]":
        """Return the graph as a networkx graph; arguments as in `contact_weights`.

        Every grain is a vertex with `role` "transmitter", "receiver" or "interior". Every contact is an edge with
        `bonded` (bool) and `weight` (float).
        """
        import networkx as nx  # noqa: PLC0415 - ranks find paths without it

        graph: nx.Graph[int] = nx.Graph()
        graph.add_nodes_from(range(self.grain_count), role="interior")
        graph.add_nodes_from(self.transmitter.tolist(), role="transmitter")
        graph.add_nodes_from(self.receiver.tolist(), role="receiver")
        lengths = self.contact_weights(bonded, weights).tolist()
        kinds = np.asarray(bonded, dtype=np.bool_).tolist()
        for (first, second), length, kind in zip(self.pairs.tolist(), lengths, kinds, strict=True):
            graph.add_edge(first, second, weight=length, bonded=kind)
        return graph


@dataclass(frozen=True, slots=True)
class PreferentialPath:
    """A shortest path from the transmitter to the receiver."""

    grains: tuple[int, ...]
    """Grains on the path, from a transmitter grain to a receiver grain."""
    bonded: tuple[bool, ...]
    """True for cemented contacts on the path; one entry fewer than grains."""

    @property
    def bonded_contacts(self) -> int:
        """Number of cemented contacts, N_LPB."""
        return sum(self.bonded)

    @property
    def hertz_contacts(self) -> int:
        """Number of sand contacts, N_h."""
        return len(self.bonded) - self.bonded_contacts


def contacts_on_path(
    graph: ContactGraph, bonded: ArrayLike, weights: ContactWeights, at_most: float = np.inf
) -> tuple[int, int]:
    """Count the sand contacts and the cemented ones, of different weights, on the shortest path that is found first.

    A path of length `at_most` is known, so grains further away are not visited. Errors are those of
    `ShortestPaths.search`, which takes twice as long.
    """
    lengths = graph.matrix(bonded, weights)
    limit = at_most * (1.0 + _RELATIVE_TIE)  # the sums of both paths are rounded
    distance, onward, _ = dijkstra(
        lengths, directed=True, indices=graph.receiver, min_only=True, return_predecessors=True, limit=limit
    )
    grain = int(graph.transmitter[np.argmin(distance[graph.transmitter])])
    _refuse_apart(distance[grain])
    chain = [grain]
    while distance[chain[-1]] > 0:
        chain.append(int(onward[chain[-1]]))
    steps = -np.diff(distance[chain])
    cemented = int(np.count_nonzero(np.abs(steps - weights.bond) < np.abs(steps - weights.hertz)))
    return len(steps) - cemented, cemented


def _refuse_apart(shortest: float) -> None:
    """Raise a `ValueError` unless the length of the shortest path is finite."""
    if not np.isfinite(shortest):
        raise ValueError("no chain of contacts joins transmitter and receiver; widen them or check the packing")


@dataclass(frozen=True, slots=True, eq=False)
class ShortestPaths:
    """All shortest paths from the transmitter to the receiver, as distances that determine the next grains."""

    distance: NDArray[np.float64]
    """Weighted distance of each grain from the nearest receiver grain, shape (N,)."""
    starts: tuple[int, ...]
    """Transmitter grains at which a shortest path starts, ascending."""
    weights: ContactWeights
    """Weight of each kind of contact."""
    _following: NDArray[np.integer]
    _cemented: NDArray[np.bool_]
    _begin: NDArray[np.integer]

    @classmethod
    def search(cls, graph: ContactGraph, bonded: ArrayLike, weights: ContactWeights) -> Self:
        """Search from all receiver grains at once (Dijkstra 1959, doi:10.1007/BF01386390).

        ``bonded`` (m,) marks cemented contacts. `ValueError` if it has another shape, or no chain of contacts joins
        transmitter and receiver.
        """
        lengths = graph.matrix(bonded, weights)
        distance = dijkstra(lengths, directed=True, indices=graph.receiver, min_only=True)
        shortest = distance[graph.transmitter].min()
        _refuse_apart(shortest)
        slack = _RELATIVE_TIE * shortest
        starts = graph.transmitter[distance[graph.transmitter] <= shortest + slack]
        # Contacts of shortest paths, grain after grain; those of grain i are between _begin[i] and _begin[i + 1].
        grain = np.repeat(np.arange(len(distance)), np.diff(lengths.indptr))
        follows = lengths.data + distance[lengths.indices] <= distance[grain] + slack
        cemented = np.asarray(bonded, dtype=np.bool_)[graph.entry_contacts][follows]
        begin = np.concatenate([[0], np.cumsum(follows)])[lengths.indptr]
        return cls(distance, tuple(starts.tolist()), weights, lengths.indices[follows], cemented, begin)

    def first(self) -> PreferentialPath:
        """Return the path that starts at, and always continues to, the grain with the lowest number.

        With only two different weights, many paths are equally short. This one depends only on the numbering of the
        grains, which is common to all cells of a campaign.
        """
        grains, kinds = [self.starts[0]], []
        while self.distance[grains[-1]] > 0:
            grain, kind = self._onward(grains[-1])[0]
            grains.append(grain)
            kinds.append(kind)
        return PreferentialPath(tuple(grains), tuple(kinds))

    def mean_longest_bonded_run(self) -> float:
        """Return the mean over all shortest paths of the longest run of cemented contacts.

        Equally short paths have runs of different lengths; each path counts once. Every step approaches the receiver,
        so the shortest paths form a graph without cycles. Its grains are visited from the transmitter on. At each
        grain, paths are counted by the length of their present run (columns), for each limit that no run exceeds
        (rows). The counts for each limit at the receiver give the distribution of the longest run.
        """
        # The length of a path bounds its number of cemented contacts.
        most = self.distance[self.starts[0]] / self.weights.bond * (1 + _RELATIVE_TIE) if self._cemented.any() else 0.0
        rows = 1 + int(most)
        within = np.tri(rows)  # the present run is within the limit, too
        nothing = np.zeros((rows, rows))
        paths = {start: nothing + (np.arange(rows) == 0) for start in self.starts}
        arrived = np.zeros(rows)
        waiting = [(-self.distance[start], start) for start in self.starts]
        heapify(waiting)
        while waiting:
            _, grain = heappop(waiting)
            here = paths.pop(grain)
            if self.distance[grain] == 0:
                arrived += here.sum(axis=1)
                continue
            for following, cemented in self._onward(grain):
                if following not in paths:
                    heappush(waiting, (-self.distance[following], following))
                    paths[following] = nothing.copy()
                if cemented:
                    paths[following][:, 1:] += here[:, :-1] * within[:, 1:]
                else:
                    paths[following][:, 0] += here.sum(axis=1)
        return float(np.sum(1.0 - arrived / arrived[-1]))

    def _onward(self, grain: int) -> list[tuple[int, bool]]:
        """Return the next grains of a shortest path, ascending, each with True if the contact is cemented."""
        contacts = slice(self._begin[grain], self._begin[grain + 1])
        return list(zip(self._following[contacts].tolist(), self._cemented[contacts].tolist(), strict=True))


_SAND = 0.01
"""Conductance of a sand contact over that of a cemented one. Their stiffnesses have a ratio of 0.003 to 0.008 in
the preset `paper`. Ratios of 0.003 to 0.1 give rank correlations of 0.61 to 0.64 with Vs within a content.
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
