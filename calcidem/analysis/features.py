"""The eight features of the preferential path for comparison with Vs (Fig. 13 of the paper).

The paper's text names five of them (LP, PLLC, QLLC, C_d and C_d,n); the three counts complete the eight of
its figure. `FEATURES` defines each, in the order of the figures, and `measure_path` computes them.
"""

from dataclasses import dataclass

from calcidem.analysis.connectivity import ContactWeights, PathScale, connectivity, normalized_connectivity
from calcidem.analysis.contact_graph import PreferentialPath
from calcidem.storage.records import PathFeatures


@dataclass(frozen=True, slots=True)
class Feature:
    """Definition of one feature; all are dimensionless."""

    name: str
    """Name of the quantity throughout (`calcidem.storage.records.PathFeatures`)."""
    symbol: str
    """Symbol in the paper."""
    definition: str
    """Definition in words."""


FEATURES = (
    Feature("path_contacts", "N", "number of contacts on the path"),
    Feature("path_hertz_contacts", "N_h", "number of sand contacts on the path"),
    Feature("path_bonded_contacts", "N_LPB", "number of cemented contacts on the path"),
    Feature("path_bonded_fraction", "LP", "share of the path's contacts that are cemented, N_LPB / N"),
    Feature(
        "path_longest_bonded_run",
        "QLLC",
        "largest number of cemented contacts that follow one another on the path; mean over all shortest paths",
    ),
    Feature(
        "path_longest_bonded_run_fraction",
        "PLLC",
        "share of the path's contacts in its longest run of cemented ones, QLLC / N",
    ),
    Feature("path_connectivity", "C_d", "weighted length of the path, omega_h N_h + omega_LPB N_LPB"),
    Feature(
        "path_normalized_connectivity",
        "C_d,n",
        "weighted length of the path on a scale where a straight row of median grains has 0 if all its "
        "contacts are cemented and 1 if none is",
    ),
)


def measure_path(
    path: PreferentialPath, longest_bonded_run: float, weights: ContactWeights, scale: PathScale
) -> PathFeatures:
    """Compute the eight features of a path of at least one contact, for the weights of the search.

    ``longest_bonded_run`` is the mean over all shortest paths. `ValueError` if both weights are equal, where C_d,n is
    undefined.
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
        path_normalized_connectivity=normalized_connectivity(c_d, weights, scale),
    )
