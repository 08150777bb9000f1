"""A rank whose words the test says."""

import fcntl
import socket
import sys
import termios
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Self

from calcidem.launch.rank_watch import RankWatch
from calcidem.launch.starter import _introduce


class SpokenRank:
    """A rank as its command hears it."""

    def __init__(self, watch: RankWatch, number: int, host: str = "nodeA", key: str = "") -> None:
        right, _, _, address, *_ = watch.address.split()
        name, _, port = address.rpartition(":")
        self._watch = watch
        self.connection = socket.create_connection((name, int(port)), 10.0)
        with ThreadPoolExecutor(1) as thread:
            greeting = thread.submit(_introduce, self.connection, key or right, str(number), host)
            while not greeting.done():
                watch.listen(0.0)
            self.welcome = greeting.exception() is None and greeting.result()

    def say(self, *lines: str) -> Self:
        """Tell the command some lines, which it takes in."""
        self.connection.sendall("".join(f"{line}\n" for line in lines).encode())
        until = time.monotonic() + 10.0
        while self._unsent() and time.monotonic() < until:  # on a busy machine even a loopback takes its time
            time.sleep(1e-3)
        hear(self._watch)
        return self

    def _unsent(self) -> int:
        """Bytes that are not yet where the watch can read them."""
        return int.from_bytes(fcntl.ioctl(self.connection, termios.TIOCOUTQ, bytes(4)), sys.byteorder)


def hear(watch: RankWatch) -> None:
    """Take in what was said, until nothing comes any more."""
    while watch.listen(0.0):
        pass
