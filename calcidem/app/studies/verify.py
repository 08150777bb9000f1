"""Recomputation of stored cells, to check whether the program still gives the stored results."""

import math
import random
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from calcidem.app.campaign.cells import cell_result
from calcidem.app.campaign.packing import with_patterns
from calcidem.app.config.schema import refuse_other_physics
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.ends import DECIDED_BY_PHYSICS
from calcidem.storage.errors import UnknownCellError
from calcidem.storage.records import EXACT_QUANTITIES, CellKey, CellResult, CementPattern, RecordedSection, Selection
from calcidem.storage.sql.store import Store

_SHARES = (
    "coherence", "reading_error", "effective_error", "vs_bias", "numerical_error", "pulse_effect", "side_error",
)  # fmt: skip
"""Numbers that are already relative, so their absolute difference counts."""


class Agreement(StrEnum):
    """Result of a comparison, from the best to the worst; the value is the text for the user."""

    SAME_BITS = "same bits"
    ROUNDING = "same to rounding"
    DIFFERENT = "different"


@dataclass(frozen=True, slots=True)
class Verification:
    """One recomputed cell."""

    stored: CellResult
    computed: CellResult
    """Both outcomes."""
    differences: Mapping[str, float]
    """Relative differences of quantities whose bits differ: infinite for missing quantities and for differing values
    that are not numbers.
    """

    @property
    def agreement(self) -> Agreement:
        """Agreement that follows from the differences."""
        if not self.differences:
            return Agreement.SAME_BITS
        # The same cell on the same packing differed between processors by up to 1e-10 while its bits still depended on
        # them. Chaos, as in slipping contacts or a new packing, causes differences above 1e-6.
        size = self.differences[self.most_different]
        return Agreement.ROUNDING if size <= 1e-9 else Agreement.DIFFERENT

    @property
    def most_different(self) -> str:
        """Name of the quantity that differs most, the first of equal ones; empty if none does."""
        return max(self.differences, key=lambda name: self.differences[name], default="")


def random_cells(store: Store, count: int, choice: int | None = None) -> tuple[CellKey, ...]:
    """Choose stored cells at random, by seed, then content; all if there are fewer.

    ``choice`` is the seed of the choice; None varies it each time. `UnknownCellError` if no cell can be recomputed.
    """
    keys = [result.key for result in store.results(Selection(statuses=DECIDED_BY_PHYSICS))]
    if not keys:
        raise UnknownCellError(
            "The campaign has no cell that could be computed again.", "Run it first ('calcidem run')."
        )
    generator = random.Random(choice)
    return tuple(sorted(generator.sample(keys, min(count, len(keys)))))


def verify(
    store: Store, keys: Iterable[CellKey], experiment_of: Callable[[int], Experiment], *, lanes: int = 8
) -> Iterator[Verification]:
    """Recompute stored cells and compare them, without changing the store; ``lanes`` cells run side by side.

    ``experiment_of`` returns the experiment of a packing's cells with the stored packing and physics, such as
    `Campaign.experiment`. `CampaignMismatchError` if the campaign has another version of the physics;
    `UnknownCellError` if a cell has no outcome.
    """
    refuse_other_physics(store.record)
    together: defaultdict[tuple[int, float], list[CellResult]] = defaultdict(list)
    for stored in with_patterns(store, (store.cell(seed=key.seed, content=key.content) for key in keys)):
        together[stored.packing_index, stored.key.content].append(stored)
    for (packing_index, content), cells in sorted(together.items(), key=lambda item: item[0]):
        experiment = experiment_of(packing_index)
        for start in range(0, len(cells), lanes):
            batch = cells[start : start + lanes]
            found = measure(experiment, content, [cell.key.seed for cell in batch], lanes=lanes)
            for stored, measurement in zip(batch, found, strict=True):
                computed = cell_result(measurement, experiment, store_sections=stored.section is not None)
                yield _compare_outcomes(stored, computed)


def _compare_outcomes(stored: CellResult, computed: CellResult) -> Verification:
    """Compare two outcomes of one cell: status, numbers, and cement and section if stored."""
    differences = {} if stored.status == computed.status else {"status": math.inf}
    for name in EXACT_QUANTITIES:
        one, other = getattr(stored, name), getattr(computed, name)
        if one == other:
            continue
        if one is None or other is None or isinstance(one, str):
            differences[name] = math.inf
        else:
            differences[name] = abs(other - one) / (1.0 if name in _SHARES else max(abs(one), abs(other)))
    if stored.cement is not None:
        differences |= _different_arrays("cement", stored.cement, computed.cement)
    if stored.section is not None:
        differences |= _different_arrays("section", stored.section, computed.section)
    return Verification(stored, computed, differences)


def _different_arrays(
    name: str, stored: CementPattern | RecordedSection, computed: CementPattern | RecordedSection | None
) -> dict[str, float]:
    """Return the differing fields of two records of arrays with their differences."""
    if computed is None:
        return {name: math.inf}
    pairs = {field.name: (getattr(stored, field.name), getattr(computed, field.name)) for field in fields(stored)}
    arrays = {field: (np.asarray(one), np.asarray(other)) for field, (one, other) in pairs.items()}
    return {
        f"{name}.{field}": _array_difference(one, other, is_counted=field in {"across", "along"})
        for field, (one, other) in arrays.items()
        if one.shape != other.shape or one.tobytes() != other.tobytes()
    }


def _array_difference(stored: npt.NDArray[Any], computed: npt.NDArray[Any], *, is_counted: bool) -> float:
    """Return the largest difference of two arrays over their largest magnitude; counts may be one apart.

    Infinite for different shapes, and for different integers that identify disks or kinds.
    """
    if stored.shape != computed.shape or not (is_counted or stored.dtype.kind == "f"):
        return math.inf
    one, other = stored.astype(np.float64), computed.astype(np.float64)
    largest = max(np.abs(one).max(initial=0.0), np.abs(other).max(initial=0.0))
    apart = max(0.0, float(np.abs(other - one).max(initial=0.0)) - is_counted)
    return float(apart / largest) if largest > 0.0 else 0.0
