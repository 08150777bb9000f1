"""Batches: cells that are computed side by side, the order in which they are handed out, and their outcomes."""

import traceback
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Generic, Self, TypeAlias, TypeVar

from calcidem.ends import CellStatus

CellT = TypeVar("CellT", bound=Hashable)

Cell: TypeAlias = tuple[int, float]
"""(seed, content in percent of the sand's mass) of a campaign's cell."""


@dataclass(frozen=True, slots=True)
class Batch(Generic[CellT]):
    """Cells that one worker computes together.

    Raises
    ------
    ValueError
        If there is no cell, the cost is not positive, or `losses` is negative.
    """

    identifier: int
    """Number of the batch, unique within a sweep."""
    cells: tuple[CellT, ...]
    """At least one cell, each hashable and picklable."""
    cost: float = 1.0
    """Expected effort in any unit, larger than zero; only ratios matter. It serves to estimate the remaining time."""
    group: Hashable = None
    """Common property of the cells (in a campaign the content); the time per cost is measured for each group."""
    losses: int = 0
    """Number of earlier runs that died while these cells were computed."""

    def __post_init__(self) -> None:
        if not self.cells:
            raise ValueError("cells is empty: a batch needs at least one cell")
        if not self.cost > 0.0:
            raise ValueError(f"cost is {self.cost}: give an estimate larger than zero")
        if self.losses < 0:
            raise ValueError(f"losses is {self.losses}: give the number of runs that died, zero or more")

    @property
    def is_alone(self) -> bool:
        """Whether no other batch may be computed meanwhile, so that another death has only one possible cause."""
        return self.losses > 1

    def split(self, first_identifier: int) -> tuple[Self, ...]:
        """Return one batch for each cell, numbered from `first_identifier`; cost and losses are kept.

        The cost is not divided: the cells fill SIMD lanes, so one cell takes about as long as the whole batch.
        """
        return tuple(
            replace(self, identifier=first_identifier + position, cells=(cell,))
            for position, cell in enumerate(self.cells)
        )


def plan_batches(
    pending: Iterable[Cell],
    lanes: int,
    cost_of_content: Callable[[float], float],
    losses: Mapping[Cell, int] | None = None,
) -> tuple[Batch[Cell], ...]:
    """Group the pending cells into batches, in the order of computation.

    All cells of a batch have the same content. The batches form rounds, one for every `lanes` seeds: whole seeds are
    complete early, so a stopped campaign is usable. Within a round the expensive contents come first, so that no long
    batch remains at the end. Cells that were computed when a run died come last, and after a second death each for
    itself, so that they affect few others. `ValueError` if `lanes` is smaller than one.

    Parameters
    ----------
    pending
        Cells to compute, (seed, content), in any order; duplicates count once.
    lanes
        Largest number of cells in a batch.
    cost_of_content
        Expected effort of one batch of the given content, in any unit.
    losses
        Number of earlier runs that died while each cell was computed; zero for cells not named.

    Returns
    -------
    tuple of Batch
        In the order in which they should be handed out, numbered from 0, `group` is the content.
    """
    if lanes < 1:
        raise ValueError(f"lanes is {lanes}: give the number of cells computed side by side, at least 1")
    losses = losses or {}
    cells = sorted(set(pending))
    groups: dict[tuple[float, int], list[Cell]] = defaultdict(list)
    for cell in cells:
        groups[cell[1], losses.get(cell, 0)].append(cell)  # by seed, as the cells are
    round_of_seed = {seed: rank // lanes for rank, seed in enumerate(sorted({seed for seed, _ in cells}))}
    batches = []
    for (content, lost), group in groups.items():
        cost, width = cost_of_content(content), 1 if lost > 1 else lanes
        batches += [
            Batch(0, tuple(group[start : start + width]), cost, content, lost) for start in range(0, len(group), width)
        ]
    # The first seed of a batch determines its round, since this seed has waited longest.
    batches.sort(key=lambda batch: (batch.losses, round_of_seed[batch.cells[0][0]], -batch.cost, batch.cells[0]))
    return tuple(replace(batch, identifier=number) for number, batch in enumerate(batches))


ResultT = TypeVar("ResultT")


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure of a batch."""

    kind: CellStatus
    """What the cells of the batch end with: failed, timed out or quarantined."""
    message: str
    """One sentence for the user."""
    traceback: str = ""
    """Python traceback of the exception; may be empty."""

    @classmethod
    def from_exception(cls, kind: CellStatus, error: BaseException) -> Self:
        """Return an exception as data, since it might not be picklable itself."""
        return cls(
            kind=kind,
            message=f"{type(error).__name__}: {error}",
            traceback="".join(traceback.format_exception(error)),
        )


@dataclass(frozen=True, slots=True)
class BatchOutcome(Generic[CellT, ResultT]):
    """Outcome of a batch.

    Raises
    ------
    ValueError
        Unless exactly one of `results` and `failure` is given, with one result for each cell.
    """

    batch: Batch[CellT]
    seconds: float
    """Wall time of the computation in s."""
    results: tuple[ResultT, ...] | None = None
    """One result for each cell in the order of `batch.cells`, or None."""
    failure: Failure | None = None
    """Reason for missing results, or None."""
    rank: int = 0
    host: str = ""
    """Number of the rank that computed it, and name of its machine."""

    def __post_init__(self) -> None:
        """Check that exactly one of both is given."""
        if (self.results is None) == (self.failure is None):
            raise ValueError(f"batch {self.batch.identifier}: give either results or failure")
        if self.results is not None and len(self.results) != len(self.batch.cells):
            raise ValueError(
                f"batch {self.batch.identifier}: {len(self.results)} results for {len(self.batch.cells)}"
                " cells; return exactly one result for each cell"
            )
