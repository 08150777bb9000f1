"""Graph summaries of graphs that can be counted by eye."""

import numpy as np

from calcidem.analysis.contact_graph import ContactGraph
from calcidem.app.campaign.task import _graph_summary
from calcidem.storage.records import GraphSummary

# Two rows of four grains from the transmitter (0, 4) to the receiver (3, 7), and one grain (8) that touches nothing:
#   0 - 1 - 2 - 3
#   |           |
#   4 - 5 - 6 - 7
PAIRS = np.array([(0, 1), (1, 2), (2, 3), (0, 4), (3, 7), (4, 5), (5, 6), (6, 7)])


def graph(pairs: np.ndarray = PAIRS) -> ContactGraph:
    """Make the graph of some contacts."""
    return ContactGraph(9, pairs, np.array([0, 4]), np.array([3, 7]))


def bonded(*contacts: tuple[int, int]) -> np.ndarray:
    """Mark contacts as cemented."""
    return np.array([tuple(pair) in contacts for pair in PAIRS.tolist()])


def test_sand_alone() -> None:
    """Without cement there are no components, and the straight way has three uncemented contacts."""
    assert _graph_summary(graph(), bonded()) == GraphSummary(8, 0, 16 / 9, 0, 0, 3)


def test_pieces_of_cement_are_counted() -> None:
    """Two pieces of cement, of three and two grains, leave one contact to cross on the upper row."""
    summary = _graph_summary(graph(), bonded((0, 1), (1, 2), (6, 7)))
    assert (summary.graph_components, summary.graph_largest_component, summary.graph_gap_contacts) == (2, 3, 1)


def test_cement_from_end_to_end_leaves_no_gap() -> None:
    """A row that is cemented through has a gap of 0, though the other row is bare."""
    summary = _graph_summary(graph(), bonded((4, 5), (5, 6), (6, 7)))
    assert (summary.graph_components, summary.graph_largest_component, summary.graph_gap_contacts) == (1, 4, 0)


def test_no_way_is_no_gap() -> None:
    """Where no chain of contacts joins transmitter and receiver there is no gap to count."""
    pairs = np.array([(0, 1), (2, 3)])
    assert _graph_summary(graph(pairs), np.array([True, False])).graph_gap_contacts is None
