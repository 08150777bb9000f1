"""The program that the launcher starts for each rank: it starts the rank and reports its state to the command.

It is a separate program that needs only Python's library, so it can report early failures. It reports facts that a
killed rank cannot: the signal, and the last line of output. If the connection to the command breaks, it ends its rank,
so that none remains on a host without network.
"""

import ctypes
import hmac
import os
import secrets
import select
import signal
import socket
import sys
import time
from pathlib import Path

COMMAND_VARIABLE = "CALCIDEM_COMMAND"
"""Variable for the ranks: key of the command, its limit of silence in seconds, its host, and its addresses."""

DESCRIPTOR_VARIABLE = "CALCIDEM_COMMAND_DESCRIPTOR"
"""Variable for a rank: file descriptor of its starter's connection."""

LONGEST_GREETING = 512
"""Largest length in bytes of a line by which command and rank authenticate each other."""

_MEANS_ITSELF = "127."
"""Beginning of loopback addresses."""

_RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")

_LOCAL_RANK_VARIABLE, _LOCAL_SIZE_VARIABLE = "OMPI_COMM_WORLD_LOCAL_RANK", "OMPI_COMM_WORLD_LOCAL_SIZE"
"""Variables with the number of a rank on its host, and of all ranks there."""

_BEATS = 20
"""Number of heartbeats within the limit of silence."""

_TIME_TO_COUNT = 60.0
"""Seconds during which the launcher's other ranks on a host are counted."""

_TIME_TO_CONNECT = 5.0
"""Seconds to try each of the command's addresses."""

_ATTEMPTS = 3
"""Number of times that all of them are tried, since the command may be busy."""

_TIME_TO_HANG_UP = 2.0
"""Seconds within which the command must acknowledge the last message of a rank."""

_LAST_LINE = 300
"""Number of characters of a rank's last line that are forwarded."""

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int | None = None) -> None:
    """Let the kernel kill this process as soon as its parent ends.

    A caller that knows the process number of its parent gives it, since the parent may have ended before this call.

    Otherwise a rank whose mpirun was killed would run for ever. It is a descendant of mpirun or, on other nodes, of its
    daemon, which ends when it loses mpirun. Call this before MPI is initialised: if the launcher has ended by then, the
    initialisation fails and the rank ends. `OSError` if the kernel refuses.
    """
    parent = parent or os.getppid()
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"prctl(PR_SET_PDEATHSIG): {os.strerror(number)}")
    if os.getppid() != parent:  # it ended before the request, so its death will not be signalled
        os.kill(os.getpid(), signal.SIGKILL)


def this_host() -> str:
    """Identifier that is equal for two processes if and only if they share loopback addresses."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    return f"{boot}/{Path('/proc/self/ns/net').readlink()}"


def seal_words(key: str, *words: str) -> str:
    """Return the seal of some words, made with the key."""
    return hmac.new(key.encode(), " ".join(words).encode(), "sha256").hexdigest()


def _introduce(connection: socket.socket, key: str, rank: str, host: str) -> bool:
    """Identify this rank to the command with a seal; return whether the command also knows the key.

    Each side seals random text of the other, drawn for this connection. The key is never sent, and recorded messages
    cannot be used again. `multiprocessing.connection` does the same but waits for each line, so a single other program
    could block the command.
    """
    challenge = _read_line(connection)
    own = secrets.token_hex(16)
    words = f"{rank} {os.getpid()} {host} {own}"
    connection.sendall(f"{words} {seal_words(key, 'rank', challenge, words)}\n".encode())
    return hmac.compare_digest(_read_line(connection).encode(), seal_words(key, "command", own, challenge).encode())


def _read_line(connection: socket.socket) -> str:
    """Read exactly one line, since the rest is for the rank; limited in bytes and seconds."""
    line, end = b"", time.monotonic() + _TIME_TO_CONNECT
    while not line.endswith(b"\n"):
        data = connection.recv(1)
        if not data or len(line) > LONGEST_GREETING or time.monotonic() > end:
            raise ConnectionError("another program listens there")
        line += data
    return line.decode(errors="replace").rstrip("\n")


class _Starter:
    """One rank and its connection to the command."""

    def __init__(self) -> None:
        self._rank = next(os.environ[name] for name in _RANK_VARIABLES if name in os.environ)
        self._key, silence, host, *addresses = os.environ[COMMAND_VARIABLE].split()
        # On another host any program may listen at a loopback address.
        self._addresses = [at for at in addresses if host == this_host() or not at.startswith(_MEANS_ITSELF)]
        self._silence = float(silence)
        self._connection = self._connect()
        self._tail = b""
        self._begin = time.monotonic()
        self._counted_missing = 0

    def run(self, command: list[str]) -> int:
        """Run the rank and return its exit code, or the signal that ended it as a negative number."""
        errors, standard_error = os.pipe()
        starter = os.getpid()
        child = os.fork()
        if child == 0:
            self._become(command, standard_error, starter)
        os.close(standard_error)
        for number in (signal.SIGUSR1, signal.SIGUSR2, signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)  # the launcher sends them to the rank as well
        self._attend(child, errors)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        os.set_blocking(errors, False)
        self._pass_on(errors)
        lines = self._tail.decode(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "")
        self._say(f"ended {code} {last[:_LAST_LINE]}")
        self._hang_up()
        return code

    def _connect(self) -> socket.socket:
        """Connect to the command at one of its addresses, and identify this rank."""
        host = os.uname().nodename
        for address in self._addresses * _ATTEMPTS:
            name, _, port = address.rpartition(":")
            try:
                connection = socket.create_connection((name, int(port)), _TIME_TO_CONNECT)
                if _introduce(connection, self._key, self._rank, host):
                    connection.settimeout(None)
                    limit = int(1000.0 * self._silence)  # time by which sent data must be acknowledged
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, limit)
                    return connection
                connection.close()
            except OSError:
                continue
        where = f"at {' or '.join(self._addresses)}: let these hosts connect to one another, firewalls included"
        if not self._addresses:
            where = "which listens on its own host alone, since neither a hostfile nor a job names other hosts"
        sys.exit(f"Rank {self._rank} on {host} cannot reach the command that started it, {where}")

    def _become(self, command: list[str], standard_error: int, starter: int) -> None:
        """Become the rank, which ends with the starter from its start on."""
        try:
            die_with_parent(starter)
            os.dup2(standard_error, 2)
            self._connection.set_inheritable(True)
            os.environ[DESCRIPTOR_VARIABLE] = str(self._connection.fileno())
            os.execvp(command[0], command)  # noqa: S606 - our own program
        except OSError as error:
            os.write(2, f"{command[0]}: {error}\n".encode())
        os._exit(127)

    def _attend(self, child: int, errors: int) -> None:
        """Forward the output of the rank and send heartbeats, until it has ended."""
        woken, waker = os.pipe()
        os.set_blocking(waker, False)
        signal.set_wakeup_fd(waker)
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, lambda *_: None)
        poll = select.poll()
        poll.register(woken, select.POLLIN)
        poll.register(errors, select.POLLIN)
        poll.register(self._connection, select.POLLRDHUP)
        beat = 0.0
        while os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            if time.monotonic() > beat:
                beat = time.monotonic() + self._silence / _BEATS
                self._say(f"alive {self._missing()}")
            for descriptor, _ in poll.poll(1000.0 * max(beat - time.monotonic(), 0.0) + 1.0):
                if descriptor == woken:
                    if signal.SIGTERM in os.read(woken, 100):
                        self._say("dismissed")  # the launcher ends the run: this host is not lost
                elif descriptor != errors:  # the command has ended, or cannot be reached any more
                    os.kill(child, signal.SIGKILL)
                    poll.unregister(descriptor)
                elif not self._pass_on(errors):
                    poll.unregister(descriptor)

    def _missing(self) -> int:
        """Number of ranks of this host found missing twice in succession; counted by two ranks for a minute."""
        if int(os.environ.get(_LOCAL_RANK_VARIABLE, "2")) > 1 or time.monotonic() - self._begin > _TIME_TO_COUNT:
            return 0
        found = 0
        for tasks in Path(f"/proc/{os.getppid()}/task").glob("*/children"):
            for process in tasks.read_text().split():
                try:
                    found += f"\0{_RANK_VARIABLES[0]}=".encode() in Path(f"/proc/{process}/environ").read_bytes()
                except OSError:
                    continue
        before, self._counted_missing = self._counted_missing, int(os.environ[_LOCAL_SIZE_VARIABLE]) - found
        return min(before, self._counted_missing) if found else 0

    def _pass_on(self, errors: int) -> bool:
        """Forward the standard error of the rank; return whether there may be more."""
        try:
            while data := os.read(errors, 1 << 16):
                self._tail = (self._tail + data)[-(1 << 12) :]
                while data:
                    data = data[os.write(2, data) :]
                if os.get_blocking(errors):
                    return True
        except BlockingIOError:
            return True
        return False

    def _hang_up(self) -> None:
        """Let the command receive the last message; closing with unread input would discard sent messages."""
        try:
            self._connection.shutdown(socket.SHUT_WR)
            self._connection.settimeout(_TIME_TO_HANG_UP)
            while self._connection.recv(1 << 16):
                pass
        except OSError:
            return  # the command has ended, or is too slow

    def _say(self, text: str) -> None:
        try:
            self._connection.sendall(f"{text}\n".encode())
        except OSError:
            return  # the poll shows that the command has ended


def _start_rank() -> None:
    """Run the rank with the command line given to this program, and end with its exit code or signal."""
    die_with_parent()
    code = _Starter().run(sys.argv[1:])
    if code < 0:
        if -code != signal.SIGKILL:
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


if __name__ == "__main__":
    _start_rank()
