"""Catalogue of all scalar quantities of a cell: name, type, unit, meaning and column, in one place.

Filters, tables and the NetCDF export read it, so that a quantity has the same name and unit everywhere.
"""

from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import SQLColumnExpression, func, literal_column

from calcidem.storage.records import CellStatus
from calcidem.storage.sql.models import AttemptRow, Base, CellRow, GraphRow, PathRow, ResultRow

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


def _columns_of(model: type[Base], *columns: tuple[str, str, str], prefix: str = "") -> list[Quantity]:
    """Quantities that are columns of a table, each with its unit and its meaning; the type of the column is theirs."""
    kinds: dict[type, Literal["real", "whole", "text"]] = {float: "real", int: "whole", str: "text"}
    return [
        Quantity(prefix + name, kinds[model.__table__.c[name].type.python_type], unit, meaning, getattr(model, name))
        for name, unit, meaning in columns
    ]


QUANTITIES = (
    *_columns_of(
        CellRow,
        ("seed", "1", "seed of the random cement pattern"),
        ("content", "percent", "calcite content by mass of sand"),
    ),
    Quantity("status", "text", "", "outcome of the cell", STATUS),
    *_columns_of(
        AttemptRow,
        ("reason", "", "why the outcome is what it is"),
    ),
    *_columns_of(
        ResultRow,
        ("vs", "m s-1", "shear-wave velocity"),
        ("vs_peak", "m s-1", "shear-wave velocity from peak to peak"),
        ("vs_first_arrival", "m s-1", "shear-wave velocity by first arrival"),
        ("vs_cross_correlation", "m s-1", "shear-wave velocity by cross-correlation"),
        ("quality_peak", "1", "quality of the peak-to-peak pick"),
        ("quality_first_arrival", "1", "quality of the first-arrival pick"),
        ("quality_cross_correlation", "1", "quality of the cross-correlation pick"),
        ("frequency", "Hz", "frequency of the sent pulse"),
        ("distance", "m", "distance that the shear wave travelled"),
        ("wavelengths_on_path", "1", "wavelengths on that distance"),
        ("wavelength_over_d50", "1", "wavelength over median diameter by mass"),
        ("time_step", "s", "time step"),
        ("stability_limit", "s", "largest stable time step"),
        ("steps", "1", "number of time steps"),
        ("expected_error", "1", "expected relative numerical error of vs"),
        ("error_bound", "1", "bound of the relative numerical error of vs"),
        ("static_speed", "m s-1", "velocity of long shear waves by statics"),
        ("content_reached", "percent", "calcite content of the cement placed, overlaps counted in full"),
        ("content_of_contacts", "percent", "calcite content of the cemented contacts by Eq. 2"),
        ("p_contacts", "1", "number of P contacts"),
        ("c_contacts", "1", "number of contacts in C clusters"),
        ("clusters", "1", "number of C clusters"),
        ("bonded_contacts", "1", "number of bonded contacts"),
        ("broken_bonds", "1", "number of bonds that the pulse broke"),
        ("retry", "", "why the sample was sent again, with half the time step"),
        ("packing_index", "1", "which of the campaign's packings"),
    ),
    *_columns_of(
        AttemptRow,
        ("seconds", "s", "computing time"),
        ("rank", "1", "MPI rank that computed it"),
        ("host", "", "host that computed it"),
    ),
    *_columns_of(
        ResultRow,
        ("attempt", "1", "number of the attempt"),
    ),
    *_columns_of(
        PathRow,
        ("contacts", "1", "contacts on the preferential path"),
        ("hertz_contacts", "1", "uncemented contacts on it"),
        ("bonded_contacts", "1", "cemented contacts on it"),
        ("bonded_fraction", "1", "share of cemented contacts on it (LP)"),
        ("longest_bonded_run_fraction", "1", "longest run of cemented contacts over all contacts on it (PLLC)"),
        ("longest_bonded_run", "1", "longest run of cemented contacts on it (QLLC)"),
        ("connectivity", "1", "weighted shortest distance (C_d)"),
        ("normalized_connectivity", "1", "normalized connectivity per unit distance (C_d,n)"),
        prefix=PATH_PREFIX,
    ),
    *_columns_of(
        GraphRow,
        ("contacts", "1", "contacts between grains"),
        ("bonded_contacts", "1", "cemented contacts between grains"),
        ("coordination_number", "1", "contacts of a grain, on average"),
        ("components", "1", "groups of grains joined by cement"),
        ("largest_component", "1", "grains in the largest of them"),
        ("gap_contacts", "1", "fewest uncemented contacts on a way from transmitter to receiver"),
        prefix=GRAPH_PREFIX,
    ),
)

QUANTITY_BY_NAME = {quantity.name: quantity for quantity in QUANTITIES}
