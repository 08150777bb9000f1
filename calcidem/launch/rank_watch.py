"""State of the ranks of a launch on all hosts, as reported by them and their starters."""

import hmac
import secrets
import selectors
import signal
import socket
import time
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Self

from calcidem.launch.starter import LONGEST_GREETING, seal_words, this_host

_LONGEST_LINE = 4096
"""Largest length of a line in bytes; no rank sends more."""

_TIME_TO_GREET = 10.0
"""Seconds within which a connection must authenticate as a rank."""

_MOST_STRANGERS = 64
"""Allowed number of unauthenticated connections, beyond one for each rank; more close the oldest."""

_PAUSE_WITHOUT_DESCRIPTORS = 0.05
"""Seconds until the next connection is accepted if this process has no free file descriptor."""

_SETTLING = 1.0
"""Seconds to wait after the first death of a rank for further ones and for the report of rank 0."""

_LAST_WORDS = 10.0
"""Seconds within which the launcher must end after rank 0."""

_HEARTBEAT_TIMEOUT = 120.0
"""Seconds without a heartbeat of rank 0 after which the user is informed; the interval is half a second."""

_MOST_SIGNALS, _LARGEST_EXIT_CODE = 64, 255

_VANISHED = "ended without a message: it was killed together with its starter, or its host is down"

_SIGNAL_CURES = {  # by name: Windows, which imports this, too, has no SIGKILL
    "SIGKILL": "the system does so when memory runs out: use fewer ranks on each host",
    "SIGSEGV": "try `calcidem doctor` on that host",
}


@dataclass(slots=True, eq=False)
class _ReportedRank:
    """A rank that has reported."""

    number: int
    host: str
    process: int
    """Number and host of the rank, and the process number of its starter."""
    connection: socket.socket
    buffer: bytes = b""
    """Connection to its starter, and the received part of the next line."""
    loaded: bool = False
    joined: bool = False
    """Whether it has loaded its program, and whether it has joined the others."""
    silent: float = 0.0
    """Seconds since its last message."""
    ended: str = ""
    ended_after: float = 0.0
    ended_well: bool = False
    killed: bool = False
    """How it ended, as the end of a sentence, empty while it lives; seconds of the launch until then; whether its exit
    code was 0; whether a signal ended it.
    """
    worded: bool = False
    """Whether its starter has reported its end, or that the launcher ends it."""
    told: bool = False
    """Whether rank 0 was informed of its end."""

    def __str__(self) -> str:
        """Name for the user."""
        return f"rank {self.number} on {self.host}"


@dataclass(slots=True, eq=False)
class _Caller:
    """A connection that may be a rank.

    Attributes
    ----------
    connection, buffer
        Connection, and the received part of its line.
    """

    connection: socket.socket
    challenge: str
    """Text that it has to seal."""
    since: float
    """Seconds of the launch at which it connected."""
    buffer: bytes = b""


class RankWatch:
    """Listener to the ranks of one launch; a context manager that ends the remaining ranks on exit.

    Any program that reaches its address can connect. Invalid input closes the connection of its sender.

    Parameters
    ----------
    size
        Number of ranks.
    addresses
        Addresses to listen at.
    start_timeout
        Seconds within which all ranks must have joined.
    silence_timeout
        Seconds without a message after which a rank's host is given up.

    Attributes
    ----------
    address
        For the ranks' environment, under `COMMAND_VARIABLE`.
    exit_code, exit_reason
        Exit code and reason that rank 0 reported: None without a report; the reason is a signal or another obstacle.
    progress
        Last progress that rank 0 reported; empty if none.
    """

    def __init__(
        self, size: int, start_timeout: float, silence_timeout: float, addresses: Sequence[str] = ("127.0.0.1",)
    ) -> None:
        self._size, self._start_timeout, self._silence_timeout = size, start_timeout, silence_timeout
        self._selector = selectors.DefaultSelector()
        places = []
        for address in addresses:
            listener = socket.create_server((address, 0), backlog=1024)
            listener.setblocking(False)
            self._selector.register(listener, selectors.EVENT_READ)
            places.append(f"{address}:{listener.getsockname()[1]}")
        self._ranks: dict[int, _ReportedRank] = {}
        self._callers: dict[_Caller, None] = {}
        self._now = time.monotonic()
        self._missing: set[str] = set()
        self._seconds = 0.0
        self._death: float | None = None
        self._sweeping = False
        self._heartbeat: float | None = None
        self._told_silent = False
        self.exit_code: int | None = None
        self.exit_reason = ""
        self.progress = ""
        self._key = secrets.token_hex(32)
        self.address = " ".join([self._key, str(silence_timeout), this_host(), *places])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        """Hang up."""
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        self._selector.close()

    @property
    def anybody_began(self) -> bool:
        """Whether any rank has reported."""
        return bool(self._ranks)

    @property
    def begun(self) -> bool:
        """Whether all ranks have joined, so that cells may have been stored."""
        return sum(rank.joined for rank in self._ranks.values()) == self._size

    def listen(self, seconds: float) -> bool:
        """Receive messages of the ranks for at most some seconds; return whether there were any."""
        events = self._selector.select(seconds)
        before, self._now = self._now, time.monotonic()
        passed = min(self._now - before, 2.0 * seconds)  # not if this process itself was stopped
        self._seconds += passed
        for rank in self._ranks.values():
            rank.silent += passed
        for key, _ in events:
            if isinstance(key.data, _ReportedRank):
                self._read(key.data)
            elif isinstance(key.data, _Caller):
                self._read_greeting(key.data)
            else:
                self._accept(key.fileobj)  # type: ignore[arg-type]
        for caller in list(self._callers):
            if self._seconds - caller.since > _TIME_TO_GREET:
                self._drop(caller)
        self._note_deaths()
        return bool(events)

    @property
    def killed_at_start(self) -> bool:
        """Whether the first rank that ended was killed before joining, or a rank ended before it could report."""
        first = self._first_death()
        return bool(self._missing) or (first is not None and first.killed and not first.joined)

    def describe_first_death(self) -> str:
        """End of the first rank that failed, else of the first that ended; empty without one."""
        first = self._first_death()
        return "" if first is None else f"{first} {first.ended}"

    def _first_death(self) -> _ReportedRank | None:
        def order(rank: _ReportedRank) -> tuple[bool, float, bool, int]:
            return rank.ended_well, rank.ended_after, rank.ended == _VANISHED, rank.number

        return min((rank for rank in self._ranks.values() if rank.ended), key=order, default=None)

    def kill_ranks(self) -> None:
        """Let the starters kill their ranks, also stopped ones, on all hosts; last messages still arrive."""
        for rank in self._ranks.values():
            with suppress(OSError):  # it has closed the connection itself
                rank.connection.shutdown(socket.SHUT_WR)

    def listen_to_the_end(self, seconds: float) -> None:
        """Receive last messages of ranks whose launcher has ended, until all have ended or some seconds have passed."""
        until = self._seconds + seconds
        while self._seconds < until and any(not rank.ended for rank in self._ranks.values()):
            self.listen(0.1)

    def ranks_left(self) -> dict[str, int]:
        """Number of ranks on each remaining host after the end of the launch; empty if no host is lost, or all are.

        A host is lost if none of its ranks has sent a last message, except for the command's own.
        """
        hosts: dict[str, list[_ReportedRank]] = defaultdict(list)
        for _, rank in sorted(self._ranks.items()):  # so that rank 0 stays on its host
            hosts[rank.host].append(rank)
        own = socket.gethostname()
        left = {host: len(ranks) for host, ranks in hosts.items() if host == own or any(rank.worded for rank in ranks)}
        return left if len(left) < len(hosts) else {}

    def describe_silent_master(self) -> str:
        """Message if the heartbeat of rank 0 has stopped, once for each stop; else empty."""
        silent = self._heartbeat is not None and self._seconds - self._heartbeat > _HEARTBEAT_TIMEOUT
        told, self._told_silent = self._told_silent, silent
        if not silent or told:
            return ""
        return (
            f"No heartbeat from {self._ranks[0]} for {_HEARTBEAT_TIMEOUT:.0f} s: it is stopped or waiting for a disk. "
            "Continue it (kill -CONT), or end this command and run it again; what is stored is safe."
        )

    def reason_to_end(self) -> str | None:
        """Reason to end the launcher: a sentence, or empty if it needs no message; None without a reason.

        While the ranks start, prepare and compile, all of them are needed. Later rank 0 handles lost workers, of which
        it is informed.
        """
        patience = self._death is not None and self._seconds - self._death
        if self.exit_code is not None:
            return "" if patience > _LAST_WORDS else None
        dead = [rank for rank in self._ranks.values() if rank.ended]
        if dead and (0 in {rank.number for rank in dead} or not self._sweeping):
            limit = _LAST_WORDS if self._sweeping else _SETTLING
            return self.describe_first_death() if patience > limit else None
        return None if self.begun else self._describe_start()

    def _describe_start(self) -> str | None:
        """Reason why some ranks will not join; None as long as all may."""
        absent = [str(number) for number in range(self._size) if number not in self._ranks]
        names = f"rank{'s' * (len(absent) > 1)} {', '.join(absent)}"
        if absent and self._missing:
            of = f"one of {names}" if len(absent) > len(self._missing) else names
            return f"{of}, on {', '.join(sorted(self._missing))}, ended before it could report: memory may have run out"
        if self._seconds < self._start_timeout:
            return None
        if absent:
            hosts = ", ".join(sorted({rank.host for rank in self._ranks.values()})) or "no host"
            return (
                f"{names} of {self._size} did not report within {self._start_timeout:g} s; those that did are on "
                f"{hosts}. See whether the other hosts can be reached and run calcidem; --start-timeout gives more time"
            )
        late = min(self._ranks.values(), key=lambda rank: (rank.joined, rank.loaded, rank.number))
        return (
            f"{late} (process {late.process}) started, but had not found the others after {self._start_timeout:g} s: "
            "it is stopped, its disk is slow, or the network between the hosts fails; --start-timeout gives more time"
        )

    def _accept(self, listener: socket.socket) -> None:
        """Request authentication from a new connection; if there are too many, the longest silent one is closed."""
        try:
            connection, _ = listener.accept()
        except BlockingIOError:
            return
        except OSError:  # no descriptor is free, or it has closed the connection already
            if self._callers:
                self._drop(next(iter(self._callers)))
            else:
                time.sleep(_PAUSE_WITHOUT_DESCRIPTORS)
            return
        if len(self._callers) >= _MOST_STRANGERS + self._size:
            self._drop(next(iter(self._callers)))
        connection.setblocking(False)
        caller = _Caller(connection, secrets.token_hex(16), self._seconds)
        self._callers[caller] = None
        self._selector.register(connection, selectors.EVENT_READ, caller)
        try:
            connection.send(f"{caller.challenge}\n".encode())
        except OSError:
            self._drop(caller)  # it has hung up already

    def _drop(self, caller: _Caller) -> None:
        """Close a connection that is no rank."""
        del self._callers[caller]
        self._hang_up(caller.connection)

    def _hang_up(self, connection: socket.socket) -> None:
        self._selector.unregister(connection)
        connection.close()

    def _read_greeting(self, caller: _Caller) -> None:
        """Read the identity of a connection; it becomes a rank if the identity is sealed with the key."""
        if caller not in self._callers:
            return  # closed since the selector returned it
        try:
            data = caller.connection.recv(LONGEST_GREETING)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        caller.buffer += data
        line, newline, rest = caller.buffer.partition(b"\n")
        if not newline:
            if not data or len(line) > LONGEST_GREETING:
                self._drop(caller)
            return
        words, _, sealed = line.decode(errors="replace").rpartition(" ")
        # Words are read only after their seal has shown that the caller knows the key.
        seal = seal_words(self._key, "rank", caller.challenge, words)
        rank = self._expected_rank(caller, words) if hmac.compare_digest(sealed.encode(), seal.encode()) else None
        if rank is None:
            self._drop(caller)
            return
        rank.buffer = rest
        del self._callers[caller]
        self._ranks[rank.number] = rank
        self._selector.modify(rank.connection, selectors.EVENT_READ, rank)
        self._take_lines(rank)

    def _expected_rank(self, caller: _Caller, words: str) -> _ReportedRank | None:
        """Rank that a caller with the key claims to be, after an answer to it; None if this rank is not expected."""
        with suppress(ValueError, OSError):
            number, process, host, drawn = words.split(" ")
            rank = _ReportedRank(int(number), host, int(process), caller.connection)
            if 0 <= rank.number < self._size and rank.number not in self._ranks:
                caller.connection.send(f"{seal_words(self._key, 'command', drawn, caller.challenge)}\n".encode())
                return rank
        return None

    def _read(self, rank: _ReportedRank) -> None:
        """Receive the messages of a rank."""
        try:
            data = rank.connection.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        rank.buffer += data
        if not self._take_lines(rank) or not data or len(rank.buffer) > _LONGEST_LINE:
            self._hang_up(rank.connection)
            if not rank.ended:
                rank.ended, rank.killed = _VANISHED, True

    def _take_lines(self, rank: _ReportedRank) -> bool:
        """Handle the complete lines received; return whether all are valid messages."""
        *lines, rank.buffer = rank.buffer.split(b"\n")
        try:
            for line in lines:
                self._hear(rank, line.decode(errors="replace"))
        except ValueError:
            return False
        return True

    def _hear(self, rank: _ReportedRank, text: str) -> None:
        """Handle a line: see `calcidem.launch.channel` for those of a rank, and `starter` for its own.

        `ValueError` if the message is not one that this rank can send.
        """
        rank.silent = 0.0
        word, _, rest = text.partition(" ")
        match word:
            case "alive":
                if int(rest) > 0:
                    self._missing.add(rank.host)
            case "dismissed":
                rank.worded = True
            case "loaded":
                rank.loaded = True
            case "joined":
                rank.joined = True
            case "ended":
                code, _, last = rest.partition(" ")
                self._note_end(rank, _exit_code(code), last)
            case _ if rank.number == 0:
                self._hear_master(rank, word, rest)
            case _:
                raise ValueError(word)

    def _hear_master(self, rank: _ReportedRank, word: str, rest: str) -> None:
        """Handle a message that only rank 0 sends."""
        match word:
            case "sweeping":
                self._sweeping = True
            case "beat" | "pause":
                self._heartbeat = self._seconds if word == "beat" else None
            case "progress":
                self.progress = rest
                with suppress(OSError):
                    rank.connection.send(b"heard\n")
            case "exit":
                code, reason = [*rest.split(), ""][:2]
                self.exit_code, self.exit_reason = _exit_code(code), reason
                self._heartbeat, self._death = None, self._seconds
            case _:
                raise ValueError(word)

    def _note_end(self, rank: _ReportedRank, code: int, last: str) -> None:
        """Describe how a rank has ended."""
        how, cure = f"ended with exit code {code}", ""
        if code < 0:
            known = -code in set(signal.Signals)  # real-time signals have no names
            name = signal.Signals(-code).name if known else f"signal {-code}"
            how, cure = f"was killed by {name}", _SIGNAL_CURES.get(name, "")
        rank.worded = True
        stage = "" if rank.joined else " while it started"
        if not rank.joined and code >= 0:
            cure = "`calcidem doctor` on that host shows what it lacks"
        rank.ended_well, rank.killed = code == 0, code < 0
        rank.ended = how + stage + (f": {last}" if last else "") + (f" ({cure})" if cure else "")

    def _note_deaths(self) -> None:
        """Record the time of the first death, and inform rank 0 of each lost worker."""
        for rank in self._ranks.values():
            if not rank.ended and rank.silent > self._silence_timeout:
                rank.ended = f"has been silent for {self._silence_timeout:g} s: its host or the network is down"
            if not rank.ended or rank.told:
                continue
            rank.told, rank.ended_after = True, self._seconds
            self._death = self._seconds if self._death is None else self._death
            if 0 in self._ranks:
                with suppress(OSError):
                    self._ranks[0].connection.send(f"lost {rank.number} {rank.ended}\n".encode())


def _exit_code(text: str) -> int:
    """Exit code, or negative number of a signal; `ValueError` for an impossible one."""
    code = int(text)
    if not -_MOST_SIGNALS <= code <= _LARGEST_EXIT_CODE:
        raise ValueError(text)
    return code
