"""Patterns of cement of other packages, or of the calling program."""

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points

import numpy as np
import numpy.typing as npt

from calcidem.dem.kernels.layout import Floats

Pattern = Callable[[Floats, np.random.Generator], npt.ArrayLike]
"""Order (M,) in which contacts are cemented, from their points (M, 2) in m and a random generator of the seed."""

GIVEN: dict[str, Pattern] = {}
"""Patterns that the calling program gave, by name; they stand before those of packages."""


class UnknownPatternError(ValueError):
    """No package has the pattern of a configuration."""


def give_patterns(patterns: Mapping[str, Pattern]) -> None:
    """Make patterns of the calling program known in this process."""
    GIVEN.update(patterns)


def find_pattern(name: str) -> Pattern:
    """Pattern of that name: given, or an entry point of the group ``calcidem.patterns``; `UnknownPatternError`."""
    if name in GIVEN:
        return GIVEN[name]
    for found in entry_points(group="calcidem.patterns", name=name):
        pattern: Pattern = found.load()
        return pattern
    known = ", ".join(sorted({*GIVEN, *entry_points(group="calcidem.patterns").names})) or "none"
    raise UnknownPatternError(
        f'drawn_by = "{name}": no installed package has this pattern (entry point of the group calcidem.patterns), and '
        f"calcidem.run was given none; known are: {known}"
    )


def draw_order(name: str, points: Floats, generator: np.random.Generator) -> npt.NDArray[np.int64]:
    """Order (M,) of contacts by a pattern; `ValueError` if it is no permutation of all contacts."""
    order = np.asarray(find_pattern(name)(points.copy(), generator))
    if order.shape != (len(points),) or not np.array_equal(np.sort(order), np.arange(len(points))):
        raise ValueError(f'drawn_by = "{name}": gives no permutation of the {len(points)} contacts; return each once')
    return order.astype(np.int64)
