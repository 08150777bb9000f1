"""Catalogue of all scalar quantities of a cell: name, type, unit, meaning and column, in one place.

Filters, tables and the NetCDF export read it, so that a quantity has the same name and unit everywhere.
"""

from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import SQLColumnExpression, func, literal_column

from calcidem.storage.records import CellStatus
from calcidem.storage.sql.models import AttemptRow, CellRow, GraphRow, PathRow, ResultRow

PATH_PREFIX = "path_"
GRAPH_PREFIX = "graph_"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A scalar that each cell has, or lacks.

    Attributes
    ----------
    name : str
    kind : {"real", "whole", "text"}
    unit : str
        UDUNITS string; empty for text.
    meaning : str
        Long name in exports.
    expression : SQLColumnExpression
        What it is in a query that joins all tables of a cell.
    """

    name: str
    kind: Literal["real", "whole", "text"]
    unit: str
    meaning: str
    expression: SQLColumnExpression[Any]


STATUS = func.coalesce(ResultRow.status, literal_column(repr(CellStatus.PENDING.value)))
"""A planned cell without a result is pending.

The word is part of the SQL text: PostgreSQL takes two parameters for different even when they are equal,
and refuses to group by this.
"""

QUANTITIES = (
    Quantity("seed", "whole", "1", "seed of the random cement pattern", CellRow.seed),
    Quantity("content", "real", "percent", "calcite content by mass of sand", CellRow.content),
    Quantity("status", "text", "", "outcome of the cell", STATUS),
    Quantity("reason", "text", "", "why the outcome is what it is", AttemptRow.reason),
    Quantity("vs", "real", "m s-1", "shear-wave velocity", ResultRow.vs),
    Quantity("vs_peak", "real", "m s-1", "shear-wave velocity from peak to peak", ResultRow.vs_peak),
    Quantity("vs_first_arrival", "real", "m s-1", "shear-wave velocity by first arrival", ResultRow.vs_first_arrival),
    Quantity(
        "vs_cross_correlation",
        "real",
        "m s-1",
        "shear-wave velocity by cross-correlation",
        ResultRow.vs_cross_correlation,
    ),
    Quantity("quality_peak", "real", "1", "quality of the peak-to-peak pick", ResultRow.quality_peak),
    Quantity(
        "quality_first_arrival", "real", "1", "quality of the first-arrival pick", ResultRow.quality_first_arrival
    ),
    Quantity(
        "quality_cross_correlation",
        "real",
        "1",
        "quality of the cross-correlation pick",
        ResultRow.quality_cross_correlation,
    ),
    Quantity("frequency", "real", "Hz", "frequency of the sent pulse", ResultRow.frequency),
    Quantity("distance", "real", "m", "distance that the shear wave travelled", ResultRow.distance),
    Quantity("wavelengths_on_path", "real", "1", "wavelengths on that distance", ResultRow.wavelengths_on_path),
    Quantity(
        "wavelength_over_d50", "real", "1", "wavelength over median diameter by mass", ResultRow.wavelength_over_d50
    ),
    Quantity("time_step", "real", "s", "time step", ResultRow.time_step),
    Quantity("stability_limit", "real", "s", "largest stable time step", ResultRow.stability_limit),
    Quantity("steps", "whole", "1", "number of time steps", ResultRow.steps),
    Quantity("energy_error", "real", "1", "largest relative error of the energy balance", ResultRow.energy_error),
    Quantity("expected_error", "real", "1", "expected relative numerical error of vs", ResultRow.expected_error),
    Quantity("error_bound", "real", "1", "bound of the relative numerical error of vs", ResultRow.error_bound),
    Quantity("static_speed", "real", "m s-1", "velocity of long shear waves by statics", ResultRow.static_speed),
    Quantity(
        *("content_reached", "real", "percent", "calcite content of the cement placed, overlaps counted in full"),
        ResultRow.content_reached,
    ),
    Quantity(
        *("content_of_contacts", "real", "percent", "calcite content of the cemented contacts by Eq. 2"),
        ResultRow.content_of_contacts,
    ),
    Quantity("p_contacts", "whole", "1", "number of P contacts", ResultRow.p_contacts),
    Quantity("c_contacts", "whole", "1", "number of contacts in C clusters", ResultRow.c_contacts),
    Quantity("clusters", "whole", "1", "number of C clusters", ResultRow.clusters),
    Quantity("bonded_contacts", "whole", "1", "number of bonded contacts", ResultRow.bonded_contacts),
    Quantity("retry", "text", "", "why the sample was sent again, with half the time step", ResultRow.retry),
    Quantity("packing_index", "whole", "1", "which of the campaign's packings", ResultRow.packing_index),
    Quantity("seconds", "real", "s", "computing time", AttemptRow.seconds),
    Quantity("rank", "whole", "1", "MPI rank that computed it", AttemptRow.rank),
    Quantity("host", "text", "", "host that computed it", AttemptRow.host),
    Quantity("attempt", "whole", "1", "number of the attempt", ResultRow.attempt),
    Quantity("path_contacts", "whole", "1", "contacts on the preferential path", PathRow.contacts),
    Quantity("path_hertz_contacts", "whole", "1", "uncemented contacts on it", PathRow.hertz_contacts),
    Quantity("path_bonded_contacts", "whole", "1", "cemented contacts on it", PathRow.bonded_contacts),
    Quantity("path_bonded_fraction", "real", "1", "share of cemented contacts on it (LP)", PathRow.bonded_fraction),
    Quantity(
        "path_longest_bonded_run_fraction",
        "real",
        "1",
        "longest run of cemented contacts over all contacts on it (PLLC)",
        PathRow.longest_bonded_run_fraction,
    ),
    Quantity(
        "path_longest_bonded_run",
        "whole",
        "1",
        "longest run of cemented contacts on it (QLLC)",
        PathRow.longest_bonded_run,
    ),
    Quantity("path_connectivity", "real", "1", "weighted shortest distance (C_d)", PathRow.connectivity),
    Quantity(
        "path_normalized_connectivity",
        "real",
        "1",
        "normalized connectivity per unit distance (C_d,n)",
        PathRow.normalized_connectivity,
    ),
    Quantity("graph_contacts", "whole", "1", "contacts between grains", GraphRow.contacts),
    Quantity("graph_bonded_contacts", "whole", "1", "cemented contacts between grains", GraphRow.bonded_contacts),
    Quantity("graph_coordination_number", "real", "1", "contacts of a grain, on average", GraphRow.coordination_number),
    Quantity("graph_components", "whole", "1", "groups of grains joined by cement", GraphRow.components),
    Quantity("graph_largest_component", "whole", "1", "grains in the largest of them", GraphRow.largest_component),
    Quantity(
        "graph_gap_contacts",
        "whole",
        "1",
        "fewest uncemented contacts on a way from transmitter to receiver",
        GraphRow.gap_contacts,
    ),
)

QUANTITY_BY_NAME = {quantity.name: quantity for quantity in QUANTITIES}
