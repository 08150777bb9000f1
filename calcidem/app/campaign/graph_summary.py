"""What the contact graph says about a sample, for the store: its preferential path and six numbers."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from calcidem.analysis.connectivity import ContactWeights
from calcidem.analysis.contact_graph import ContactGraph, preferential_path
from calcidem.analysis.packing_graph import PackingGraph, features_record
from calcidem.storage.records import CellResult, GraphSummary

ALMOST_NOTHING = ContactWeights(hertz=1.0, bond=1e-7)
"""Cemented contacts count so little that no number of them outweighs an uncemented one."""


def with_graph(result: CellResult, packing: PackingGraph) -> CellResult:
    """Return an outcome together with its path features and its graph summary.

    One without cement pattern, whose cell was never made, is returned as it is. Where no chain of contacts joins
    transmitter and receiver there is no path.
    """
    if result.cement is None:
        return result
    bonded = packing.bonded(result.cement)
    summary = graph_summary(packing.graph, bonded)
    features = None if summary.gap_contacts is None else features_record(packing.features(bonded))
    return replace(result, features=features, graph=summary)


def graph_summary(graph: ContactGraph, bonded: npt.NDArray[np.bool_]) -> GraphSummary:
    """Summarise the graph of one sample.

    Parameters
    ----------
    graph
        Contacts of the packing.
    bonded
        Which of them are cemented, shape (m,).
    """
    first, second = graph.pairs[bonded].T
    count = graph.grain_count
    cement = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    _, component = connected_components(cement, directed=False)
    grains = np.bincount(component)
    pieces = grains[grains > 1]
    return GraphSummary(
        contacts=graph.contact_count,
        bonded_contacts=int(np.count_nonzero(bonded)),
        coordination_number=graph.coordination_number,
        components=len(pieces),
        largest_component=int(pieces.max(initial=0)),
        gap_contacts=fewest_uncemented_contacts(graph, bonded),
    )


def fewest_uncemented_contacts(graph: ContactGraph, bonded: npt.NDArray[np.bool_]) -> int | None:
    """Return how many uncemented contacts the best way from transmitter to receiver has; None without any way."""
    try:
        return preferential_path(graph, bonded, ALMOST_NOTHING).hertz_contacts
    except ValueError:
        return None
