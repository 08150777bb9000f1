"""Standard errors of velocities, and cells whose velocity depends on the pulse."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calcidem.storage.records.error_budget import depends_on_pulse

BUDGET_QUANTITIES = ("vs", "reading_error", "numerical_error", "pulse_effect", "vs_error")
"""Quantities of each cell that `error_budget` needs."""


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Errors of the velocities of some cells."""

    total: float
    reading: float
    numerical: float
    pulse: float
    """Medians of the relative standard error of Vs and of its three parts; NaN if unknown."""
    scatter: float
    """Root mean square of the reading errors, m/s: their part of the standard deviation of Vs. NaN if all velocities
    are equal: seeds without cement are one sample with one reading error.
    """
    loud: int
    """Number of velocities that depend on the pulse."""

    @property
    def texts(self) -> tuple[str, str]:
        """Texts on the standard error of a velocity, and on its parts."""
        if not np.isfinite(self.total):
            return "unknown", "no error of the reading is stored"
        parts = (self.total, self.reading, self.numerical, self.pulse)
        total, reading, numerical, pulse = (f"{100 * part:.2g} %" for part in parts)
        return total, f"median; reading {reading}, simulation {numerical}, pulse {pulse}"

    def __str__(self) -> str:
        """Return both in one text."""
        total, parts = self.texts
        return f"{total} ({parts})"


def error_budget(cells: Mapping[Any, ArrayLike]) -> ErrorBudget:
    """Summarise the errors of cells: `BUDGET_QUANTITIES` by name, arrays of one shape with NaN if missing."""
    vs, reading, numerical, pulse, total = (np.asarray(cells[name], dtype=float) for name in BUDGET_QUANTITIES)
    absolute = (vs * reading)[np.isfinite(vs * reading)]
    known = vs[np.isfinite(vs)]
    varies = bool(known.size) and bool(np.ptp(known) > 0.0)
    return ErrorBudget(
        total=median_known(total),
        reading=median_known(reading),
        numerical=median_known(numerical),
        pulse=median_known(pulse),
        scatter=float(np.sqrt(np.mean(absolute**2))) if varies and absolute.size else np.nan,
        loud=int((np.isfinite(vs) & depends_on_pulse(pulse)).sum()),
    )


def median_known(given: ArrayLike) -> float:
    """Median of the finite values; NaN if there are none."""
    values = np.asarray(given, dtype=float)
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan
