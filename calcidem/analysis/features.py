"""The eight features of the preferential path that are compared with Vs (Fig. 13 of the paper).

The paper's text names five of them (LP, PLLC, QLLC, C_d and C_d,n); the three counts complete the eight of
its figure. Each is defined once, in `FEATURES`: name, symbol, definition in words, and the function that
computes it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from numpy.typing import ArrayLike

from calcidem.analysis.connectivity import ContactWeights, PathScale, connectivity, normalized_connectivity
from calcidem.analysis.contact_graph import ContactGraph, PreferentialPath, preferential_path


@dataclass(frozen=True, slots=True)
class PathMeasure:
    """What a feature is computed from: a path and the weights and scale that go with it."""

    path: PreferentialPath
    weights: ContactWeights
    scale: PathScale


@dataclass(frozen=True, slots=True)
class Feature:
    """Definition of one feature; all are dimensionless.

    Parameters
    ----------
    name
        The attribute of `PathFeatures` that holds it.
    symbol
        As in the paper.
    definition
        In words.
    compute
        Function of the measured path.
    """

    name: str
    symbol: str
    definition: str
    compute: Callable[[PathMeasure], float]


@dataclass(frozen=True, slots=True)
class PathFeatures:
    """The path of one sample and its eight features; `FEATURES` defines them."""

    path: PreferentialPath
    contacts: int
    hertz_contacts: int
    bonded_contacts: int
    bonded_fraction: float
    longest_bonded_run: int
    longest_bonded_run_fraction: float
    connectivity: float
    normalized_connectivity: float


def _contacts(measure: PathMeasure) -> int:
    return len(measure.path.bonded)


def _longest_bond_run(measure: PathMeasure) -> int:
    return max((sum(run) for _, run in groupby(measure.path.bonded)), default=0)


def _connectivity(measure: PathMeasure) -> float:
    return connectivity(measure.path.hertz_contacts, measure.path.bonded_contacts, measure.weights)


FEATURES = (
    Feature("contacts", "N", "number of contacts on the path", _contacts),
    Feature("hertz_contacts", "N_h", "number of sand contacts on the path", lambda m: m.path.hertz_contacts),
    Feature("bonded_contacts", "N_LPB", "number of cemented contacts on the path", lambda m: m.path.bonded_contacts),
    Feature(
        "bonded_fraction",
        "LP",
        "share of the path's contacts that are cemented, N_LPB / N",
        lambda m: m.path.bonded_contacts / _contacts(m),
    ),
    Feature(
        "longest_bonded_run",
        "QLLC",
        "largest number of cemented contacts that follow one another on the path",
        _longest_bond_run,
    ),
    Feature(
        "longest_bonded_run_fraction",
        "PLLC",
        "share of the path's contacts in its longest run of cemented ones, QLLC / N",
        lambda m: _longest_bond_run(m) / _contacts(m),
    ),
    Feature(
        "connectivity",
        "C_d",
        "weighted length of the path, omega_h N_h + omega_LPB N_LPB",
        _connectivity,
    ),
    Feature(
        "normalized_connectivity",
        "C_d,n",
        "weighted length of the path on a scale where a straight row of median grains has 0 if all its "
        "contacts are cemented and 1 if none is",
        lambda m: normalized_connectivity(_connectivity(m), m.weights, m.scale),
    ),
)


def measure_path(path: PreferentialPath, weights: ContactWeights, scale: PathScale) -> PathFeatures:
    """Compute the eight features of a path.

    Parameters
    ----------
    path
        The path, with at least one contact.
    weights
        The weights it is shortest for.
    scale
        Distance and grain size.

    Raises
    ------
    ValueError
        If the two weights are equal, where C_d,n is undefined.
    """
    measure = PathMeasure(path, weights, scale)
    values: dict[str, Any] = {feature.name: feature.compute(measure) for feature in FEATURES}
    return PathFeatures(path=path, **values)


def path_features(graph: ContactGraph, bonded: ArrayLike, weights: ContactWeights, scale: PathScale) -> PathFeatures:
    """Find the preferential path of one sample and compute its eight features.

    Parameters
    ----------
    graph
        The contacts of the packing.
    bonded
        Which of them are cemented in this sample, booleans, shape (m,).
    weights
        Weight of each kind of contact.
    scale
        Distance and grain size.

    Raises
    ------
    ValueError
        If no chain of contacts joins transmitter and receiver, or the two weights are equal.
    """
    return measure_path(preferential_path(graph, bonded, weights), weights, scale)
