"""Standard errors of velocities, and cells whose two velocities differ."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calcidem.storage.records.error_budget import departs

BUDGET_QUANTITIES = ("vs", "reading_error", "numerical_error", "vs_error", "path_departure")
"""Quantities of each cell that `error_budget` needs."""


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Errors of the velocities of some cells."""

    total: float
    reading: float
    numerical: float
    """Medians of the relative standard error of Vs and of its two parts; NaN if unknown."""
    scatter: float
    """Root mean square of the reading errors, m/s: their part of the standard deviation of Vs. NaN if all velocities
    are equal: seeds without cement are one sample with one reading error.
    """
    compared: int
    departing: int
    """Number of cells with both velocities, and number of those that differ by more than their errors."""

    @property
    def texts(self) -> tuple[str, str]:
        """Texts on the standard error of a velocity, and on its parts."""
        if not np.isfinite(self.total):
            return "unknown", "no error of the reading is stored"
        total, reading, numerical = (f"{100 * part:.2g} %" for part in (self.total, self.reading, self.numerical))
        return total, f"median; reading {reading}, simulation {numerical}"

    def __str__(self) -> str:
        """Return both in one text."""
        total, parts = self.texts
        return f"{total} ({parts})"


def error_budget(cells: Mapping[Any, ArrayLike]) -> ErrorBudget:
    """Summarise the errors of cells: `BUDGET_QUANTITIES` by name, arrays of one shape with NaN if missing."""
    vs, reading, numerical, total, departure = (np.asarray(cells[name], dtype=float) for name in BUDGET_QUANTITIES)
    absolute = (vs * reading)[np.isfinite(vs * reading)]
    known = vs[np.isfinite(vs)]
    varies = bool(known.size) and bool(np.ptp(known) > 0.0)
    return ErrorBudget(
        total=median_known(total),
        reading=median_known(reading),
        numerical=median_known(numerical),
        scatter=float(np.sqrt(np.mean(absolute**2))) if varies and absolute.size else np.nan,
        compared=int(np.isfinite(departure).sum()),
        departing=int(departs(departure).sum()),
    )


def median_known(given: ArrayLike) -> float:
    """Median of the finite values; NaN if there are none."""
    values = np.asarray(given, dtype=float)
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan
