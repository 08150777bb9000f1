"""Connect to a port of this host as one who is no rank, in every unfriendly way, until killed.

Usage: strangers.py PORT WAY..; a way is ``idle``, which stays, or one of `WAYS`, which are done again and again. It
says "ready" once it has done each. It needs nothing but Python's library, and no rights.
"""

import contextlib
import random
import resource
import socket
import struct
import sys
import time

_IDLE = 1100
"""Connections that stay: more than a process usually has file descriptors for."""


def _garbage(connection: socket.socket) -> None:
    connection.sendall(random.randbytes(random.choice((1, 100, 10_000))))


def _reset(connection: socket.socket) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def _slow(connection: socket.socket) -> None:
    for byte in b"0 1 here 0":
        connection.sendall(bytes([byte]))
        time.sleep(0.02)


def _long(connection: socket.socket) -> None:
    connection.sendall(b"a" * (1 << 20))


def _half_open(connection: socket.socket) -> None:
    connection.shutdown(socket.SHUT_WR)
    connection.recv(100)


def _pretend(connection: socket.socket) -> None:
    connection.sendall(b"0 1 here %s %s\n" % (b"a" * 32, b"b" * 64))
    connection.recv(100)


WAYS = {
    "garbage": _garbage,
    "reset": _reset,
    "slow": _slow,
    "long": _long,
    "half-open": _half_open,
    "pretend": _pretend,
}


def main(port: int, ways: list[str]) -> None:
    """Do it."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(limit, 4096), limit))
    idle = [_connect(port) for _ in range(_IDLE if "idle" in ways else 0)]
    ready = False
    while True:
        for way in ways:
            if way != "idle":
                with contextlib.suppress(OSError), _connect(port) as connection:
                    WAYS[way](connection)
        if not ready:
            sys.stdout.write("ready\n")
            sys.stdout.flush()
            ready = True
        time.sleep(0.01)
        assert len(idle) in {0, _IDLE}


def _connect(port: int) -> socket.socket:
    while True:
        with contextlib.suppress(ConnectionError, TimeoutError):
            return socket.create_connection(("127.0.0.1", port), 5.0)
        time.sleep(0.05)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
