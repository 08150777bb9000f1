"""What a command concludes from the words of its ranks, which are sockets of the test here."""

import selectors
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from spoken_rank import SpokenRank, hear

from calcidem.launch import rank_watch
from calcidem.launch.rank_watch import RankWatch


class Clock:
    """The watch's time, which passes only on order, by so many seconds each time that it is looked at."""

    def __init__(self) -> None:
        self.now = self.step = 0.0

    def monotonic(self) -> float:
        """Stand in the place of `time.monotonic`."""
        self.now += self.step
        return self.now

    def let_pass(self, watch: RankWatch, seconds: float) -> None:
        """Let the watch listen for so long by its own time."""
        self.step = 1.0
        for _ in range(round(seconds)):
            watch.listen(1.0)
        self.step = 0.0


class ImpatientSelector(selectors.DefaultSelector):
    """Waits for next to no time, whatever it is asked to."""

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Tell what is ready."""
        return super().select(0.0 if timeout == 1.0 else 0.02)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Give the time of all watches."""
    clock = Clock()
    monkeypatch.setattr(rank_watch, "time", clock)
    monkeypatch.setattr("selectors.DefaultSelector", ImpatientSelector)
    return clock


@pytest.fixture
def watch(clock: Clock) -> Iterator[RankWatch]:
    """Give the watch over three ranks, which have 120 s to start and may be silent for 60 s."""
    assert clock.now == 0.0
    with RankWatch(3, start_timeout=120.0, silence_timeout=60.0) as watch:
        yield watch


@pytest.fixture
def ranks(watch: RankWatch) -> list[SpokenRank]:
    """Give three ranks on three hosts that have found one another."""
    return [SpokenRank(watch, number, f"node{'ABC'[number]}").say("loaded", "joined") for number in range(3)]


@pytest.mark.parametrize(
    "said", [{"key": "0" * 64}, {"host": "a" * 5000}, {"number": 3}, {"number": -1}, {"number": 1}, {"host": "a b"}]
)
def test_who_does_not_know_the_key_is_no_rank(watch: RankWatch, said: dict[str, Any]) -> None:
    """Nor is one of another number, or of a rank that is there: it is hung up on, and ranks are not disturbed."""
    rank = SpokenRank(watch, 1)
    assert rank.welcome
    stranger = SpokenRank(watch, **({"number": 0} | said))
    assert not stranger.connection.recv(100)
    rank.say("loaded", "joined")
    SpokenRank(watch, 2).say("joined")
    assert not watch.begun
    SpokenRank(watch, 0).say("joined")
    assert watch.begun


def test_ranks_that_do_not_report_are_named(watch: RankWatch, clock: Clock) -> None:
    """When the time to start is over the run has to end, and it is said who is missing and where the others are."""
    rank = SpokenRank(watch, 1, "nodeB").say("joined")
    for _ in range(3):
        assert watch.reason_to_end() is None
        clock.let_pass(watch, 41.0)
        rank.say("alive 0")
    why = watch.reason_to_end() or ""
    assert "ranks 0, 2 of 3 did not report within 120 s; those that did are on nodeB" in why


@pytest.mark.parametrize(
    ("end", "how"),
    [
        ("ended 3 no licence", "ended with exit code 3 while it started: no licence (`calcidem doctor`"),
        ("ended -9 ", "was killed by SIGKILL while it started (the system does so when memory runs out"),
    ],
)
def test_a_death_before_all_are_there_ends_the_run(watch: RankWatch, clock: Clock, end: str, how: str) -> None:
    """The reason names rank, host, how it ended, its last words and a cure, once others had a second to say more."""
    SpokenRank(watch, 1, "nodeB").say(end)
    assert watch.reason_to_end() is None
    clock.let_pass(watch, 2.0)
    assert (watch.reason_to_end() or "").startswith(f"rank 1 on nodeB {how}")
    assert watch.killed_at_start == ("-9" in end)


def test_another_start_may_do_better_only_where_the_first_death_was_a_kill(watch: RankWatch, clock: Clock) -> None:
    """A rank killed with its starter counts; what the launcher kills after a rank has failed by itself does not."""
    SpokenRank(watch, 1).connection.close()
    hear(watch)
    assert watch.killed_at_start
    with RankWatch(3, start_timeout=120.0, silence_timeout=60.0) as other:
        SpokenRank(other, 2).say("ended 1 no licence")
        clock.let_pass(other, 1.0)
        SpokenRank(other, 1).say("ended -15 ")
        assert not other.killed_at_start
        SpokenRank(other, 0).say("alive 1")
        assert other.killed_at_start  # one was gone before its first word


def test_a_lost_worker_is_told_to_rank_0_and_no_reason_to_end(
    watch: RankWatch, ranks: list[SpokenRank], clock: Clock
) -> None:
    """While cells are computed, a host that falls silent costs its ranks only; nothing else is lost."""
    ranks[0].say("sweeping")
    for _ in range(4):
        clock.let_pass(watch, 20.0)
        for rank in ranks[:2]:
            rank.say("alive 0")
    told = ranks[0].connection.recv(1000).decode()
    assert told == "lost 2 has been silent for 60 s: its host or the network is down\n"
    assert watch.reason_to_end() is None


def test_the_end_of_rank_0_counts(watch: RankWatch, ranks: list[SpokenRank], clock: Clock) -> None:
    """Its exit code and the signal that asked for it are known, and the launcher has 10 s to end by itself."""
    ranks[0].say("sweeping", "beat", "exit 75 SIGUSR1")
    assert (watch.exit_code, watch.exit_reason) == (75, "SIGUSR1")
    clock.let_pass(watch, 9.0)
    assert watch.reason_to_end() is None
    clock.let_pass(watch, 2.0)
    assert watch.reason_to_end() == ""


def test_a_master_without_heartbeat_is_told_of_once(watch: RankWatch, ranks: list[SpokenRank], clock: Clock) -> None:
    """Unless it has said that it may be busy for long."""

    def let_two_minutes_pass() -> str:
        for _ in range(3):
            clock.let_pass(watch, 41.0)
            for rank in ranks:
                rank.say("alive 0")
        return watch.describe_silent_master()

    ranks[0].say("sweeping", "beat", "pause")
    assert let_two_minutes_pass() == ""
    ranks[0].say("beat")
    assert let_two_minutes_pass().startswith("No heartbeat from rank 0 on nodeA for 120 s")
    assert let_two_minutes_pass() == ""


def test_a_host_without_a_last_word_is_left_out(watch: RankWatch, clock: Clock) -> None:
    """Not one whose ranks the launcher ended, nor the command's own, in whatever order their deaths are seen."""
    own = socket.gethostname()
    ranks = [SpokenRank(watch, number, host).say("joined") for number, host in enumerate((own, "nodeB", "nodeC"))]
    ranks[2].say("dismissed")
    for rank in (ranks[2], ranks[0], ranks[1]):
        rank.connection.close()
        clock.let_pass(watch, 2.0)
    assert watch.ranks_left() == {own: 1, "nodeC": 1}


def test_no_host_is_left_out_where_all_end_with_a_word(watch: RankWatch, ranks: list[SpokenRank]) -> None:
    """A run that mpirun itself has ended goes on with all hosts."""
    for rank in ranks:
        rank.say("ended -15 ")
    assert watch.ranks_left() == {}
