"""The unit of work: cells that are computed side by side, and the order in which they are handed out."""

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Generic, Self, TypeAlias, TypeVar

CellT = TypeVar("CellT", bound=Hashable)

Cell: TypeAlias = tuple[int, float]
"""(seed, content in percent of the sand mass): the cell of a campaign as `plan_batches` knows it."""


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
    """Expected effort in any unit, larger than zero; only ratios matter. Used for the time left."""
    group: Hashable = None
    """What the cells have in common (the content, in a campaign): cost is measured per group."""
    losses: int = 0
    """Number of workers that were lost over these cells, in this run and in earlier ones."""

    def __post_init__(self) -> None:
        if not self.cells:
            raise ValueError("cells is empty: a batch needs at least one cell")
        if not self.cost > 0.0:
            raise ValueError(f"cost is {self.cost}: give an estimate larger than zero")
        if self.losses < 0:
            raise ValueError(f"losses is {self.losses}: give the number of lost workers, zero or more")

    def with_another_loss(self) -> Self:
        """Return the same batch with one more lost worker."""
        return replace(self, losses=self.losses + 1)

    def split(self, first_identifier: int) -> tuple[Self, ...]:
        """Return one batch for each cell, numbered from `first_identifier`; cost and losses are kept.

        The cost is not divided: a batch fills SIMD lanes, so one cell takes about as long as all of them.
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
    """Group the pending cells into batches and put them in the order in which to compute them.

    All cells of a batch share the content. The batches form waves, one for every `lanes` seeds, so that whole seeds are
    complete early and a campaign that is stopped at any time is usable; within a wave the expensive contents come
    first, so that no long batch is left over at the end. Cells over which a worker was lost come last and alone, where
    they harm no other cell. `ValueError` if `lanes` is smaller than one.

    Parameters
    ----------
    pending
        Cells to compute, (seed, content), in any order; duplicates count once.
    lanes
        Largest number of cells in a batch.
    cost_of_content
        Expected effort of one batch of the given content, in any unit.
    losses
        Number of workers lost over each cell in earlier runs; cells not named have none.

    Returns
    -------
    tuple of Batch
        In the order in which they should be handed out, numbered from 0, `group` is the content.
    """
    if lanes < 1:
        raise ValueError(f"lanes is {lanes}: give the number of cells computed side by side, at least 1")
    losses = losses or {}
    cells = sorted(set(pending))
    suspects = [cell for cell in cells if losses.get(cell, 0) > 0]
    groups: dict[float, list[Cell]] = defaultdict(list)
    for cell in cells:
        if losses.get(cell, 0) == 0:
            groups[cell[1]].append(cell)  # by seed, as the cells are
    wave_of_seed = {seed: rank // lanes for rank, seed in enumerate(sorted({seed for seed, _ in cells}))}
    cost = {content: cost_of_content(content) for content in {content for _, content in cells}}

    chunks = [tuple(group[start : start + lanes]) for group in groups.values() for start in range(0, len(group), lanes)]
    # The wave of a batch is that of its first seed: that is the seed which waits for it the longest.
    chunks.sort(key=lambda chunk: (wave_of_seed[chunk[0][0]], -cost[chunk[0][1]], chunk[0]))
    chunks.extend((cell,) for cell in sorted(suspects, key=lambda cell: (losses[cell], cell)))
    return tuple(
        Batch(
            identifier=identifier,
            cells=chunk,
            cost=cost[chunk[0][1]],
            group=chunk[0][1],
            losses=losses.get(chunk[0], 0),
        )
        for identifier, chunk in enumerate(chunks)
    )
