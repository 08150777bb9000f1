from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calcidem.sweep.schedule import Batch, plan_batches

CELLS = st.sets(st.tuples(st.integers(0, 40), st.sampled_from([0.0, 0.66, 5.0, 9.0])))


def cost(content: float) -> float:
    """Return an effort that grows with the content."""
    return 1.0 + content


@given(cells=CELLS, lanes=st.integers(1, 16))
def test_each_pending_cell_is_in_exactly_one_batch(cells: set[tuple[int, float]], lanes: int) -> None:
    """A plan holds each cell once, in batches of one content and at most as many cells as lanes."""
    plan = plan_batches(cells, lanes, cost)
    assert sorted(cell for batch in plan for cell in batch.cells) == sorted(cells)
    for batch in plan:
        assert len(batch.cells) <= lanes
        assert {content for _, content in batch.cells} == {batch.group}
    assert [batch.identifier for batch in plan] == list(range(len(plan)))


@given(cells=CELLS, lanes=st.integers(1, 16))
def test_a_plan_does_not_depend_on_the_order_of_the_cells(cells: set[tuple[int, float]], lanes: int) -> None:
    """The same cells in another order give the same plan."""
    assert plan_batches(sorted(cells), lanes, cost) == plan_batches(sorted(cells, reverse=True), lanes, cost)


def test_whole_seeds_come_early() -> None:
    """All contents of the first seeds come before any content of the later ones."""
    cells = [(seed, content) for seed in range(24) for content in (0.0, 5.0, 9.0)]
    plan = plan_batches(cells, 8, cost)
    for wave in range(3):
        seeds = {seed for batch in plan[3 * wave : 3 * wave + 3] for seed, _ in batch.cells}
        assert seeds == set(range(8 * wave, 8 * wave + 8))


def test_expensive_contents_come_first_within_a_wave() -> None:
    """Within a wave the cost falls."""
    cells = [(seed, content) for seed in range(8) for content in (0.0, 9.0, 5.0)]
    plan = plan_batches(cells, 8, cost)
    assert all(earlier.cost > later.cost for earlier, later in pairwise(plan))


def test_cells_with_losses_come_last_and_from_the_second_on_alone() -> None:
    """Cells that were computed when a run died come at the end, side by side after one death, alone after two."""
    cells = [(seed, 5.0) for seed in range(8)]
    plan = plan_batches(cells, 4, cost, losses={(0, 5.0): 2, (1, 5.0): 2, (3, 5.0): 1, (4, 5.0): 1})
    last = [(batch.cells, batch.losses, batch.is_alone) for batch in plan[-3:]]
    assert last == [
        (((3, 5.0), (4, 5.0)), 1, False),
        (((0, 5.0),), 2, True),
        (((1, 5.0),), 2, True),
    ]
    assert all(batch.losses == 0 for batch in plan[:-3])


def test_a_plan_needs_at_least_one_lane() -> None:
    """Zero lanes are refused with the name of the argument."""
    with pytest.raises(ValueError, match="lanes is 0"):
        plan_batches([(0, 0.0)], 0, cost)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"cells": ()}, "cells is empty"),
        ({"cells": (1,), "cost": 0.0}, "cost is 0.0"),
        ({"cells": (1,), "cost": float("nan")}, "cost is nan"),
        ({"cells": (1,), "losses": -1}, "losses is -1"),
    ],
)
def test_a_batch_refuses_impossible_values(arguments: dict[str, object], message: str) -> None:
    """A batch without cells, without cost or with negative losses cannot be made."""
    with pytest.raises(ValueError, match=message):
        Batch(0, **arguments)


def test_splitting_keeps_cost_losses_and_order() -> None:
    """The parts of a batch are its cells, one by one, each as expensive and as suspect as the whole."""
    parts = Batch(3, ("a", "b"), cost=7.0, group=5.0, losses=2).split(10)
    assert [part.identifier for part in parts] == [10, 11]
    assert [part.cells for part in parts] == [("a",), ("b",)]
    assert {(part.cost, part.group, part.losses) for part in parts} == {(7.0, 5.0, 2)}
