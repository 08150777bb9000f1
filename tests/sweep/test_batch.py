from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from calcidem.sweep.schedule import plan_batches

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
        assert len({content for _, content in batch.cells}) == 1


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
