"""Error of a velocity from its three parts.

The formula is written once, for numbers, arrays and columns of a database: its first argument is the square root.
"""

from collections.abc import Callable
from typing import Any

from calcidem.storage.records.quantity import Quantity

NORMAL_95 = 1.96
"""Half-width of the 95 % interval of a normal variable, in standard errors."""

MOST_PULSE_EFFECT = 0.02
"""Relative standard error by the strength of the pulse above which velocities do not belong to the sample."""

Root = Callable[[Any], Any]


def _vs_error(root: Root, reading: Any, numerical: Any, pulse: Any) -> Any:  # noqa: ANN401 - number, array or column
    """Total of three independent parts."""
    return root(reading * reading + numerical * numerical + pulse * pulse)


DERIVED_QUANTITIES = (
    Quantity(
        *("1", "relative standard error of vs by reading, simulation and pulse", "error budget"),
        name="vs_error",
        is_optional=True,
        needs=("reading_error", "numerical_error", "pulse_effect"),
        formula=_vs_error,
    ),
)
"""Quantities that are not stored; each follows from stored ones, and is missing if one of these is."""


def depends_on_pulse(pulse_effect: Any) -> Any:  # noqa: ANN401 - number or array
    """Whether a velocity depends on the pulse; False without a known effect (NaN)."""
    return pulse_effect > MOST_PULSE_EFFECT
