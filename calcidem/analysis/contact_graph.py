"""Grains and contacts as a weighted undirected graph: the preferential path of shear waves (section 2.4).

Its weighted length is the connectivity C_d, or normalised C_d,n (Eqs. 8 and 9 of the paper).
"""

from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

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

    def matrix(self, bonded: ArrayLike, weights: ContactWeights) -> csr_array:
        """Return the symmetric sparse matrix of contact weights, shape (N, N); see `contact_weights`."""
        return self.with_entries(self.contact_weights(bonded, weights)[self.entry_contacts])

    def with_entries(self, values: NDArray[np.float64]) -> csr_array:
        """Return a sparse matrix (N, N) with a value (2 m,) for each entry; `entry_contacts` are their contacts."""
        return csr_array((values, self._neighbours, self._row_starts), shape=(self.grain_count, self.grain_count))

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
