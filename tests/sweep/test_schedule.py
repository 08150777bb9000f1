from calcidem.ends import CellStatus
from calcidem.sweep.schedule import Batch, BatchOutcome, Failure, Schedule


def failed(batch: Batch[str], kind: CellStatus = CellStatus.FAILED) -> BatchOutcome[str, int]:
    """Return the outcome of a batch that failed."""
    return BatchOutcome(batch, 1.0, failure=Failure(kind, "on order"))


def drain(schedule: Schedule[str]) -> list[tuple[str, ...]]:
    """Return the cells of all batches in the order in which they would be handed out."""
    cells = []
    while (batch := schedule.take()) is not None:
        cells.append(batch.cells)
    return cells


def test_batches_come_in_the_order_given() -> None:
    """The schedule does not reorder."""
    schedule = Schedule((Batch(("b",)), Batch(("a",)), Batch(("c",))))
    assert drain(schedule) == [("b",), ("a",), ("c",)]


def test_batches_that_are_added_come_last() -> None:
    """After those given before, and after the parts of a split one."""
    schedule = Schedule((Batch(("a", "b")), Batch(("c",))))
    schedule.extend([Batch(("d",))])
    first = schedule.take()
    assert first is not None
    schedule.settle(failed(first))
    assert drain(schedule) == [("a",), ("b",), ("c",), ("d",)]


def test_a_batch_that_raised_is_computed_again_cell_by_cell_next() -> None:
    """After an exception the single cells go ahead of everything that still waits."""
    schedule = Schedule((Batch(("a", "b")), Batch(("c", "d"))))
    first = schedule.take()
    assert first is not None
    assert schedule.settle(failed(first)) is None
    assert drain(schedule) == [("a",), ("b",), ("c", "d")]


def test_splitting_keeps_cost_and_losses() -> None:
    """The parts of a batch are each as expensive and as suspect as the whole."""
    schedule = Schedule((Batch(("a", "b"), cost=7.0, losses=2),))
    whole = schedule.take()
    assert whole is not None
    schedule.settle(failed(whole))
    assert [*iter(schedule.take, None)] == [Batch((cell,), cost=7.0, losses=2) for cell in ("a", "b")]


def test_a_single_cell_that_raised_is_settled() -> None:
    """One cell alone is not tried again."""
    schedule = Schedule((Batch(("a",)),))
    batch = schedule.take()
    assert batch is not None
    outcome = failed(batch)
    assert schedule.settle(outcome) is outcome
    assert (schedule.tally.total(), schedule.tally[CellStatus.FAILED], len(schedule)) == (1, 1, 0)


def test_a_batch_that_timed_out_is_settled_as_a_whole() -> None:
    """Cells that advance side by side would time out alone as well."""
    schedule = Schedule((Batch(("a", "b")),))
    batch = schedule.take()
    assert batch is not None
    assert schedule.settle(failed(batch, CellStatus.TIMED_OUT)) is not None
    assert (schedule.tally.total(), schedule.tally[CellStatus.TIMED_OUT], len(schedule)) == (2, 2, 0)


def test_what_takes_down_workers_beside_others_is_tried_alone() -> None:
    """What was computed on the same worker may be the cause; a cell that takes one down alone is."""
    schedule = Schedule((Batch(("one",)),))
    batch = schedule.take()
    assert batch is not None
    assert schedule.settle(failed(batch, CellStatus.QUARANTINED)) is None
    again = schedule.take()
    assert again is not None
    assert (again.cells, again.is_alone) == (("one",), True)
    assert schedule.settle(failed(again, CellStatus.QUARANTINED)) is not None


def test_the_cell_that_takes_down_workers_is_quarantined_alone() -> None:
    """The executor's verdict on a batch is only that one of its cells is deadly; its company is computed."""
    schedule = Schedule((Batch(("good", "deadly", "fine")),))
    done, settled = [], []
    while (batch := schedule.take()) is not None:
        if "deadly" in batch.cells:
            settled.append(schedule.settle(failed(batch, CellStatus.QUARANTINED)))
        else:
            results = BatchOutcome(batch, 1.0, results=(1,) * len(batch.cells))
            assert schedule.settle(results) is results
            done.extend(batch.cells)
    assert sorted(done) == ["fine", "good"]
    assert [outcome and outcome.batch.cells for outcome in settled] == [None, ("deadly",)]
    assert (schedule.tally.total(), schedule.tally[CellStatus.QUARANTINED]) == (3, 1)
