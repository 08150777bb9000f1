import pytest

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
    schedule = Schedule((Batch(1, ("b",)), Batch(0, ("a",)), Batch(2, ("c",))))
    assert drain(schedule) == [("b",), ("a",), ("c",)]


def test_equal_identifiers_are_refused() -> None:
    """Two batches with the same number cannot be told apart."""
    with pytest.raises(ValueError, match="same identifier"):
        Schedule((Batch(1, ("b",)), Batch(1, ("a",))))


def test_batches_that_are_added_have_numbers_of_their_own() -> None:
    """Neither those given later nor the parts of a split one have the number of another."""
    schedule = Schedule((Batch(0, ("a", "b")), Batch(4, ("c",))))
    further = schedule.extend([Batch(0, ("d",))])
    first = schedule.take()
    assert first is not None
    schedule.settle(failed(first))
    numbers = [batch.identifier for batch in iter(schedule.take, None)]
    assert len({first.identifier, *numbers}) == 5
    assert further[0].identifier in numbers


def test_a_batch_that_raised_is_computed_again_cell_by_cell_next() -> None:
    """After an exception the single cells go ahead of everything that still waits."""
    schedule = Schedule((Batch(0, ("a", "b")), Batch(1, ("c", "d"))))
    first = schedule.take()
    assert first is not None
    assert schedule.settle(failed(first)) is None
    assert drain(schedule) == [("a",), ("b",), ("c", "d")]


def test_a_single_cell_that_raised_is_settled() -> None:
    """One cell alone is not tried again."""
    schedule = Schedule((Batch(0, ("a",)),))
    batch = schedule.take()
    assert batch is not None
    outcome = failed(batch)
    assert schedule.settle(outcome) is outcome
    assert (schedule.tally.total(), schedule.tally[CellStatus.FAILED], len(schedule)) == (1, 1, 0)


def test_a_batch_that_timed_out_is_settled_as_a_whole() -> None:
    """Cells that advance side by side would time out alone as well."""
    schedule = Schedule((Batch(0, ("a", "b")),))
    batch = schedule.take()
    assert batch is not None
    assert schedule.settle(failed(batch, CellStatus.TIMED_OUT)) is not None
    assert (schedule.tally.total(), schedule.tally[CellStatus.TIMED_OUT], len(schedule)) == (2, 2, 0)


def test_the_cell_that_takes_down_workers_is_quarantined_alone() -> None:
    """The executor's verdict on a batch is only that one of its cells is deadly; its company is computed."""
    schedule = Schedule((Batch(0, ("good", "deadly", "fine")),))
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
