"""Who can reach the port of a run can neither end it nor hold a rank: what comes costs the sender its connection."""

import os
import resource
import selectors
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoken_rank import SpokenRank, hear

from calcidem.launch import addresses, rank_watch, starter
from calcidem.launch.rank_watch import RankWatch

STRANGERS = Path(__file__).parent / "programs" / "strangers.py"
NOBODY = 65534  # the user without rights on Linux

WORDS = ("alive", "dismissed", "loaded", "joined", "sweeping", "beat", "pause", "progress", "exit", "ended", "lost", "")
VALUES = ("", "0", "-9", "75 SIGUSR1", "999 x", "-99999999999", "1e9", "x y", "\x1b[2J", "{}", "٣", "-34 a", "9" * 5000)

raw = st.lists(
    st.one_of(st.binary(max_size=200), st.sampled_from([b"\n", b"a" * 600, b"0 1 here x\n", bytes(9000), b"\n" * 99]))
)
lines = st.lists(st.tuples(st.sampled_from(WORDS), st.sampled_from(VALUES)).map(" ".join))
ends = st.sampled_from(["close", "reset", "half-open", "stay"])


@contextmanager
def watching(size: int = 3) -> Iterator[RankWatch]:
    """Give a watch on loopback."""
    with RankWatch(size, start_timeout=120.0, silence_timeout=60.0) as watch:
        yield watch


def place_of(watch: RankWatch) -> tuple[str, int]:
    """Where a watch listens."""
    name, _, port = watch.address.split()[3].rpartition(":")
    return name, int(port)


def end(connection: socket.socket, how: str) -> None:
    """End a connection, or leave it half open or as it is."""
    if how == "reset":
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    if how == "half-open":
        with suppress(OSError):
            connection.shutdown(socket.SHUT_WR)
    if how in {"close", "reset"}:
        connection.close()


def judge(watch: RankWatch, false_rank: int | None = None, make_room: Callable[[], None] = lambda: None) -> None:
    """Ranks that nobody pretends to be are heard, and whatever is asked of the watch has an answer.

    ``make_room`` is called before each of them connects: here they need descriptors of the watch's own process.
    """
    true = [number for number in range(3) if number != false_rank]
    ranks = []
    for number in true:
        make_room()
        ranks.append(SpokenRank(watch, number).say("loaded", "joined", "alive 0"))
    assert all(rank.welcome for rank in ranks)
    assert watch.begun == (false_rank is None) or watch._ranks[2].joined
    assert all(watch._ranks[number].joined and not watch._ranks[number].ended for number in true)
    for ask in (watch.reason_to_end, watch.describe_first_death, watch.describe_silent_master, watch.ranks_left):
        ask()
    if false_rank != 0:
        ranks[0].say("progress {}", "exit 75 ")
        assert (watch.exit_code, watch.progress) == (75, "{}")
    for rank in ranks:
        rank.connection.close()


def throw(watch: RankWatch, pieces: Sequence[bytes], how: str) -> socket.socket:
    """Connect and send something, piece by piece."""
    connection = socket.create_connection(place_of(watch), 10.0)
    watch.listen(0.0)
    for piece in pieces:
        with suppress(OSError):
            connection.sendall(piece)
        watch.listen(0.0)
    end(connection, how)
    hear(watch)
    return connection


def survive(examples: list[tuple[list[bytes], str]], said: tuple[int, list[str], str] | None) -> None:
    """Let strangers and a false rank speak, and then the true ranks."""
    with watching() as watch:
        left = [throw(watch, pieces, how) for pieces, how in examples]
        false_rank = None
        if said is not None:
            false_rank, texts, how = said
            rank = SpokenRank(watch, false_rank)
            with suppress(OSError):
                rank.connection.sendall("".join(f"{text}\n" for text in texts).encode())
            hear(watch)
            end(rank.connection, how)
            left.append(rank.connection)
            if false_rank != 0:
                assert watch.exit_code is None
                assert watch.progress == ""
        judge(watch, false_rank)
        for connection in left:
            connection.close()


anything = (
    st.lists(st.tuples(raw, ends), max_size=4),
    st.none() | st.tuples(st.sampled_from([0, 2]), lines, ends),
)


@settings(max_examples=25, deadline=None)
@given(*anything)
def test_whatever_arrives_costs_its_sender_alone(
    examples: list[tuple[list[bytes], str]], said: tuple[int, list[str], str] | None
) -> None:
    """Bytes of strangers, and lines of a false rank that knows the key, change nothing for the true ranks."""
    survive(examples, said)


@pytest.mark.full
@settings(max_examples=5000, deadline=None)
@given(*anything)
def test_whatever_arrives_costs_its_sender_alone_in_thousands(
    examples: list[tuple[list[bytes], str]], said: tuple[int, list[str], str] | None
) -> None:
    """The same with five thousand inputs."""
    survive(examples, said)


@pytest.fixture
def strangers() -> Iterator[Callable[..., "subprocess.Popen[bytes]"]]:
    """Give a function that starts strangers; they are killed after the test."""
    started = []

    def start(port: int, *ways: str) -> "subprocess.Popen[bytes]":
        # A copy of the text, since another user may not read this folder.
        command = [sys.executable, "-I", "-S", "-c", STRANGERS.read_text(encoding="utf-8"), str(port), *ways]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("descriptors", [None, 20])
def test_idle_connections_neither_end_the_watch_nor_keep_ranks_out(
    strangers: Callable[..., "subprocess.Popen[bytes]"], descriptors: int | None
) -> None:
    """1,100 of them, more than this process may have open, and also where it may open only a few more."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with watching() as watch, selectors.DefaultSelector() as selector:
        process = strangers(place_of(watch)[1], "idle")
        assert process.stdout is not None
        selector.register(process.stdout, selectors.EVENT_READ)
        # The strangers' connections take whatever is free, so each rank has a descriptor kept for it.
        kept = [os.open(os.devnull, os.O_RDONLY) for _ in range(3)]
        gaps = []
        if descriptors is not None:
            highest = max(int(path.name) for path in Path("/proc/self/fd").iterdir())
            while not gaps or gaps[-1] < highest:
                gaps.append(os.open(os.devnull, os.O_RDONLY))
            resource.setrlimit(resource.RLIMIT_NOFILE, (gaps[-1] + 1 + descriptors, limits[1]))
        try:
            while not selector.select(0.0):
                watch.listen(0.01)
            judge(watch, make_room=lambda: os.close(kept.pop()))
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
            for descriptor in (*kept, *gaps):
                os.close(descriptor)


def test_one_who_says_nothing_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has some seconds to identify itself."""
    monkeypatch.setattr(rank_watch, "_TIME_TO_GREET", 0.05)
    with watching() as watch, socket.create_connection(place_of(watch), 10.0) as connection:
        watch.listen(0.01)
        assert watch._callers
        while watch._callers:
            watch.listen(0.01)
        assert connection.recv(100).endswith(b"\n")
        assert connection.recv(100) == b""


def test_one_who_listens_in_the_place_of_the_command_learns_nothing_and_holds_no_rank() -> None:
    """The key does not travel, what is heard is good for one connection, and who cannot seal_words is no command."""
    heard = []
    with socket.create_server(("127.0.0.1", 0)) as impostor, watching() as watch:
        key = watch.address.split()[0]

        def listen() -> None:
            connection, _ = impostor.accept()
            with connection:
                connection.sendall(b"0" * 32 + b"\n")
                heard.append(connection.recv(starter.LONGEST_GREETING))
                connection.sendall(b"f" * 64 + b"\n")

        thread = threading.Thread(target=listen)
        thread.start()
        with socket.create_connection(impostor.getsockname(), 10.0) as rank:
            assert not starter._introduce(rank, key, "0", "here")
        thread.join()
        assert key.encode() not in heard[0]
        throw(watch, heard, "stay").close()  # said again to the true command
        assert watch._ranks == {}
        judge(watch)


def test_loopback_is_for_ranks_of_this_host_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """On another host anybody may listen there: a rank does not even try."""
    tried: list[tuple[str, int]] = []

    def refuse(place: tuple[str, int], _seconds: float) -> None:
        tried.append(place)
        raise ConnectionRefusedError

    monkeypatch.setattr(socket, "create_connection", refuse)
    monkeypatch.setenv("PMIX_RANK", "1")
    for host, wanted in ((starter.this_host(), {"127.0.0.1", "192.0.2.1"}), ("another/net:[1]", {"192.0.2.1"})):
        tried.clear()
        monkeypatch.setenv(starter.COMMAND_VARIABLE, f"key 60 {host} 127.0.0.1:1 192.0.2.1:1")
        with pytest.raises(SystemExit, match="cannot reach the command"):
            starter._Starter()
        assert {name for name, _ in tried} == wanted


def test_a_command_listens_where_its_ranks_need_it(tmp_path: Path) -> None:
    """On loopback alone unless something names other hosts, and then at the addresses that face these."""
    mpirun = tmp_path / "bin" / "mpirun"
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc" / "prte-default-hostfile").write_text("# nobody\n")
    hosts = tmp_path / "hosts"
    hosts.write_text(f"{socket.gethostname()} slots=2\nlocalhost:2\n")
    alone = ["127.0.0.1"]
    assert addresses.listening_addresses(str(mpirun), {}) == alone
    assert addresses.listening_addresses(str(mpirun), {"SLURM_JOB_NUM_NODES": "1"}) == alone
    own = addresses.listening_addresses(str(mpirun), {"MPIRUN": "/a/script"})
    assert own[0] == alone[0]
    assert addresses.listening_addresses(str(mpirun), {"PRTE_MCA_prte_default_hostfile": str(hosts)}) == alone
    hosts.write_text(
        "127.0.0.2 slots=2\n"
    )  # an address of this host: the one that faces it is that itself, or loopback
    facing = addresses.listening_addresses(str(mpirun), {"PBS_NODEFILE": str(hosts)})
    assert set(facing) <= {"127.0.0.1", "127.0.0.2"}
    assert addresses.listening_addresses(str(mpirun), {"OMPI_MCA_rmaps_rankfile": str(hosts)}) == own
    assert addresses.listening_addresses(str(mpirun), {"PBS_NODEFILE": str(tmp_path / "none")}) == own
