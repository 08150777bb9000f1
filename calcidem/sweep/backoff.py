"""Waiting without using a core."""

import time
from collections.abc import Callable


class Backoff:
    """Sleeps that get longer while nothing happens.

    At most 2 ms, which hardly delays a batch of seconds; such polling uses 1 to 2 % of a core.
    """

    SHORTEST = 20e-6
    LONGEST = 2e-3

    def __init__(self) -> None:
        self._pause = self.SHORTEST

    def reset(self) -> None:
        """Start again with the shortest sleep, after an event."""
        self._pause = self.SHORTEST

    def sleep(self) -> None:
        """Sleep, the next time twice as long."""
        time.sleep(self._pause)
        self._pause = min(2.0 * self._pause, self.LONGEST)


def wait_until(condition: Callable[[], bool], limit: float = float("inf")) -> bool:
    """Poll with increasing sleeps until `condition` holds or `limit` seconds have passed; return whether it holds."""
    backoff = Backoff()
    end = time.monotonic() + limit
    while not condition():
        if time.monotonic() > end:
            return False
        backoff.sleep()
    return True
