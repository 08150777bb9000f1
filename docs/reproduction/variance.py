"""Division of a variance between two crossed causes, for the pages of reproduction."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class VarianceParts:
    """Variance of Vs at one content, divided between two crossed causes, each part in (m/s)^2."""

    first: float
    second: float
    """Parts of the two causes; unbiased estimates, which may be negative for no effect."""
    rest: float
    """Part of the interaction and of everything else."""
    mean: float
    """Mean of all values, m/s."""

    @property
    def total(self) -> float:
        """Variance of a value with two newly drawn causes."""
        return self.first + self.second + self.rest

    @property
    def deviations(self) -> tuple[float, float, float]:
        """Standard deviations of the three parts, m/s; zero for a negative estimate."""
        first, second, rest = (max(0.0, part) ** 0.5 for part in (self.first, self.second, self.rest))
        return first, second, rest


def variance_parts(values: np.ndarray) -> VarianceParts:
    """Divide the variance of a complete table (m/s), at least 2 x 2, into rows, columns and the rest.

    Two-way random-effects analysis of variance with one value per cell. `ValueError` for gaps or a smaller table.
    """
    rows, columns = values.shape
    if min(rows, columns) < 2 or not np.isfinite(values).all():  # a variance needs two
        raise ValueError(f"values {values.shape}: give a complete table of at least 2 x 2")
    mean = float(values.mean())
    by_row, by_column = values.mean(axis=1), values.mean(axis=0)
    left = values - by_row[:, None] - by_column[None, :] + mean
    rest = float(np.sum(left**2)) / ((rows - 1) * (columns - 1))
    return VarianceParts(
        first=float(by_row.var(ddof=1)) - rest / columns,
        second=float(by_column.var(ddof=1)) - rest / rows,
        rest=rest,
        mean=mean,
    )
