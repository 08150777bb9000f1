"""Remaining time of a sweep, from the cost of its batches so far."""

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable
from typing import Any

from calcidem.sweep.batch import Batch
from calcidem.sweep.outcome import BatchOutcome


class Forecast:
    """Counts cells and measures their cost in each group of batches.

    A measured group counts with its own mean seconds for each cell. Others count with their estimated cost, scaled by
    the ratio of measured to estimated cost elsewhere.

    Parameters
    ----------
    batches
        All batches of the sweep.
    """

    def __init__(self, batches: Iterable[Batch[Any]]) -> None:
        self._cells: Counter[Hashable] = Counter()
        self._remaining: Counter[Hashable] = Counter()
        self._cost: dict[Hashable, float] = defaultdict(float)
        self._seconds: dict[Hashable, float] = defaultdict(float)
        self._measured: Counter[Hashable] = Counter()
        self.extend(batches)

    def extend(self, batches: Iterable[Batch[Any]]) -> None:
        """Count further batches."""
        for batch in batches:
            self._cells[batch.group] += len(batch.cells)
            self._remaining[batch.group] += len(batch.cells)
            self._cost[batch.group] += batch.cost

    @property
    def total(self) -> int:
        """Number of cells of all batches."""
        return self._cells.total()

    def _estimate(self, group: Hashable) -> float:
        """Expected cost of a cell, in the unit of the batches."""
        return self._cost[group] / self._cells[group]

    @property
    def settled(self) -> int:
        """Number of cells that are settled."""
        return self.total - self._remaining.total()

    def record(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Count a final outcome; only results measure the cost of a cell."""
        group, cells = outcome.batch.group, len(outcome.batch.cells)
        self._remaining[group] -= cells
        if outcome.failure is None:
            self._seconds[group] += outcome.seconds
            self._measured[group] += cells

    def seconds_left(self, workers: int) -> float | None:
        """Return the seconds that the remaining cells need on this number of workers, or None if unknown."""
        estimated = sum(self._estimate(group) * cells for group, cells in self._measured.items())
        if self.settled == self.total:
            return 0.0
        if estimated == 0.0 or workers < 1:
            return None
        scale = sum(self._seconds.values()) / estimated
        work = 0.0
        for group, cells in self._remaining.items():
            measured = self._measured[group]
            per_cell = self._seconds[group] / measured if measured else self._estimate(group) * scale
            work += cells * per_cell
        return work / workers
