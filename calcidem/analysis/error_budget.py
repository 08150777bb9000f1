"""Standard errors of velocities, and cells whose velocity depends on the pulse."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calcidem.storage.records.error_budget import depends_on_pulse

BUDGET_QUANTITIES = ("vs", "reading_error", "numerical_error", "pulse_effect", "vs_error")
"""Quantities of each cell that `error_budget` needs, besides its content."""


def are_samples(vs: ArrayLike, content: ArrayLike) -> NDArray[np.bool_]:
    """Whether each cell is a distinct sample with a velocity: the population of all numbers about a campaign.

    Without cement all seeds give the same sample, so only the first of them counts. ``content``, percent, broadcasts to
    the shape of ``vs``; NaN where a cell has no velocity.
    """
    found: NDArray[np.bool_] = np.isfinite(np.asarray(vs, dtype=float))
    bare = found & (np.asarray(content, dtype=float) == 0.0)
    found[bare] = np.arange(np.count_nonzero(bare)) == 0
    return found


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Errors of the velocities of some cells."""

    total: float
    reading: float
    numerical: float
    pulse: float
    """Medians of the relative standard error of Vs and of its three parts, over the samples of which all are known, so
    that no part exceeds the whole; NaN if unknown.
    """
    scatter: float
    """Root mean square of the reading errors, m/s: their part of the standard deviation of Vs. NaN for one sample."""
    loud: int
    """Number of samples whose velocity depends on the pulse."""

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
    """Summarise the errors of the distinct samples with a velocity among cells.

    ``cells`` has content, and `BUDGET_QUANTITIES` in arrays of one shape with NaN if missing.
    """
    counted = are_samples(cells["vs"], cells["content"])
    columns = np.array([np.asarray(cells[name], dtype=float)[counted] for name in BUDGET_QUANTITIES])
    vs, reading, _, pulse, _ = columns
    known = columns[:, np.isfinite(columns).all(axis=0)]
    _, *parts, total = known if known.size else columns
    absolute = (vs * reading)[np.isfinite(vs * reading)]
    return ErrorBudget(
        total=median_known(total),
        reading=median_known(parts[0]),
        numerical=median_known(parts[1]),
        pulse=median_known(parts[2]),
        scatter=float(np.sqrt(np.mean(absolute**2))) if vs.size > 1 and absolute.size else np.nan,
        loud=int(depends_on_pulse(pulse).sum()),
    )


def median_known(given: ArrayLike) -> float:
    """Median of the finite values; NaN if there are none."""
    values = np.asarray(given, dtype=float)
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan
