"""Outcomes are stored in groups on a thread of their own, and shown once they are stored."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from calcidem.sweep.run import GroupCommit
from calcidem.sweep.schedule import Batch, BatchOutcome, Progress


@dataclass
class SlowSink:
    """Keeps the numbers of the outcomes, one list for each call, as soon as it may."""

    may_store: threading.Event = field(default_factory=threading.Event)
    begun: threading.Event = field(default_factory=threading.Event)
    stored: list[list[int]] = field(default_factory=list)
    error: Exception | None = None

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]], /) -> None:
        """Wait until it may, then keep or raise."""
        self.begun.set()
        assert self.may_store.wait(10.0)
        if self.error is not None:
            raise self.error
        self.stored.append([outcome.batch.cells[0] for outcome in outcomes])

    def keep_alive(self) -> None:
        """Do nothing."""

    def mark(self, batches: Sequence[Batch[Any]], /) -> None:
        """Keep the marks of batches as their negative numbers."""
        self.stored.append([-batch.cells[0] for batch in batches])


class Shown(Progress):
    """Notes which outcomes are shown."""

    def __init__(self) -> None:
        self.shown: list[int] = []

    def on_outcome(self, outcome: BatchOutcome[Any, Any]) -> None:
        """Note it."""
        self.shown.append(outcome.batch.cells[0])


def outcome(number: int) -> BatchOutcome[int, int]:
    """Outcome of a batch of the cell with this number."""
    return BatchOutcome(Batch((number,)), 1.0, results=(number,))


@pytest.fixture
def sink() -> SlowSink:
    """Make a sink that stores nothing yet."""
    return SlowSink()


@pytest.fixture
def progress() -> Shown:
    """Make a display that has shown nothing."""
    return Shown()


@pytest.fixture
def commits(sink: SlowSink, progress: Shown) -> GroupCommit[int]:
    """Make what is tested."""
    return GroupCommit(sink, progress)


def test_what_comes_while_a_group_is_stored_is_the_next_group_and_nothing_is_shown_before_it_is_stored(
    sink: SlowSink, progress: Shown, commits: GroupCommit[int]
) -> None:
    """One outcome begins a group; the three that come meanwhile share the next one, after the marks."""
    with commits:
        commits.add(outcome(1))
        commits.advance()
        assert sink.begun.wait(10.0)
        for number in (2, 3, 4):
            commits.add(outcome(number))
            commits.advance()
        assert (sink.stored, progress.shown) == ([], [])
        sink.may_store.set()
        commits.mark(outcome(9).batch, outcome(8).batch)
        commits.flush()
        assert (sink.stored, progress.shown) == ([[1], [-9, -8], [2, 3, 4]], [1, 2, 3, 4])
        commits.add(outcome(5))
    assert (sink.stored[-1], progress.shown[-1]) == ([5], 5)


def test_an_error_of_the_sink_is_passed_on_and_ends_the_storing(
    sink: SlowSink, progress: Shown, commits: GroupCommit[int]
) -> None:
    """What was to be stored with it or after it is neither stored nor shown."""
    sink.error = OSError("disk full")
    sink.may_store.set()
    with commits:
        commits.add(outcome(1))
        commits.advance()
        commits.add(outcome(2))
        with pytest.raises(OSError, match="disk full"):
            commits.flush()
    assert (sink.stored, progress.shown) == ([], [])


def test_another_error_still_lets_everything_be_stored(
    sink: SlowSink, progress: Shown, commits: GroupCommit[int]
) -> None:
    """Leaving the block by an exception loses no outcome that was added."""

    def go_wrong() -> None:
        with commits:
            commits.add(outcome(1))
            raise KeyError

    sink.may_store.set()
    with pytest.raises(KeyError):
        go_wrong()
    assert (sink.stored, progress.shown) == ([[1]], [1])


def test_a_store_that_falls_behind_asks_for_no_more(sink: SlowSink, commits: GroupCommit[int]) -> None:
    """Outcomes that wait fill the memory at most so far."""
    with commits:
        commits.add(*map(outcome, range(500)))
        assert not commits.is_full
        commits.add(*map(outcome, range(500, 600)))
        assert commits.is_full != bool(sink.stored)
        sink.may_store.set()
