"""Contact graph of a stored packing, and the eight features of a path (Fig. 13 of the paper).

The paper's text names five of them (LP, PLLC, QLLC, C_d and C_d,n); the three counts complete the eight of its figure.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from inspect import getdoc
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calcidem.analysis.connectivity import ContactWeights, connectivity, normalized_connectivity, straight_contacts
from calcidem.analysis.contact_graph import ContactGraph, PreferentialPath, ShortestPaths
from calcidem.analysis.contact_network import ContactNetwork, contact_network
from calcidem.storage.records import CementPattern, PackingRecord, PathFeatures

FEATURES = {
    "path_contacts": ("N", "number of contacts on the path"),
    "path_hertz_contacts": ("N_h", "number of sand contacts on the path"),
    "path_bonded_contacts": ("N_LPB", "number of cemented contacts on the path"),
    "path_bonded_fraction": ("LP", "share of the path's contacts that are cemented, N_LPB / N"),
    "path_longest_bonded_run": (
        "QLLC",
        "largest number of cemented contacts that follow one another on the path; mean over all shortest paths",
    ),
    "path_longest_bonded_run_fraction": (
        "PLLC",
        "share of the path's contacts in its longest run of cemented ones, QLLC / N",
    ),
    "path_connectivity": ("C_d", "weighted length of the path, omega_h N_h + omega_LPB N_LPB"),
    "path_normalized_connectivity": (
        "C_d,n",
        "weighted length of the path, 0 for a straight row of median grains with all contacts cemented, 1 with none",
    ),
}
"""Symbol in the paper and definition of each feature, by its name in `PathFeatures`; all are dimensionless."""


def _measure_path(
    path: PreferentialPath, longest_bonded_run: float, weights: ContactWeights, straight: float
) -> PathFeatures:
    """Compute the eight features of a path of at least one contact, for the weights of the search.

    ``longest_bonded_run`` is the mean over all shortest paths, ``straight`` that of `PackingGraph`. `ValueError` for
    equal weights, where C_d,n is undefined.
    """
    contacts = len(path.bonded)
    c_d = connectivity(path.hertz_contacts, path.bonded_contacts, weights)
    return PathFeatures(
        path_contacts=contacts,
        path_hertz_contacts=path.hertz_contacts,
        path_bonded_contacts=path.bonded_contacts,
        path_bonded_fraction=path.bonded_contacts / contacts,
        path_longest_bonded_run_fraction=longest_bonded_run / contacts,
        path_longest_bonded_run=longest_bonded_run,
        path_connectivity=c_d,
        path_normalized_connectivity=normalized_connectivity(c_d, weights, straight),
    )


@dataclass(frozen=True, slots=True, eq=False)
class PackingGraph:
    """Contacts of a packing, and the data that turn its paths into features."""

    packing: PackingRecord
    """The disks."""
    graph: ContactGraph
    """Contacts, and grains at transmitter and receiver."""
    weights: ContactWeights
    """Weights by their physical meaning (Eq. 8 of the paper), from the coordination number of all grains."""
    straight: float
    """Contacts of a straight row of grains of the median diameter by count, from transmitter to receiver."""
    network: ContactNetwork
    """The contacts with what features of the cement as a network need."""
    _keys: NDArray[np.int64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Number the contacts for fast lookup by patterns."""
        object.__setattr__(self, "_keys", _contact_keys(self.graph.pairs, self.graph.grain_count))

    def bonded(self, cement: CementPattern) -> NDArray[np.bool_]:
        """Return True for cemented contacts of the graph, shape (m,).

        `ValueError` if the pattern cements two grains that do not touch.
        """
        mask = np.zeros(self.graph.contact_count, dtype=np.bool_)
        mask[self._rows(cement.contacts)] = True
        return mask

    def kinds(self, cement: CementPattern) -> NDArray[np.uint8]:
        """Return 0 (sand), 1 (P) or 2 (C) for each contact of the graph, shape (m,); errors as for `bonded`."""
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
        """Return the features of the shortest paths of one sample."""
        return _measure_path(paths.first(), paths.mean_longest_bonded_run(), self.weights, self.straight)

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
    graph = ContactGraph(
        grain_count=packing.radius.size,
        pairs=touching[np.lexsort((touching[:, 1], touching[:, 0]))],
        transmitter=np.flatnonzero((packing.x < packing.radius) & (off_centre < transmitter_half_width)),
        receiver=np.flatnonzero((packing.width - packing.x < packing.radius) & (off_centre < receiver_half_width)),
    )
    return PackingGraph(
        packing=packing,
        graph=graph,
        weights=ContactWeights.from_coordination_number(graph.coordination_number),
        straight=straight_contacts(packing.width, 2 * float(np.median(packing.radius))),
        network=contact_network(packing, graph, boundary_thickness),
    )


def _contact_keys(pairs: NDArray[np.int64], grain_count: int) -> NDArray[np.int64]:
    first, second = pairs.T
    keys: NDArray[np.int64] = np.minimum(first, second) * grain_count + np.maximum(first, second)
    return keys
