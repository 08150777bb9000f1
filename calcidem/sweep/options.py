"""Settings of a sweep."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SweepOptions:
    """Limits of a sweep, equal on all ranks.

    Three successive limits guard a batch. After `time_limit` the check of the computation ends it; only the batch is
    lost. After `hard_limit` the operating system kills the worker, also inside compiled code. After `watchdog_limit`
    the master gives the worker up, even if it is stopped or its node is down.

    Raises
    ------
    ValueError
        If a value is out of its range.
    """

    time_limit: float | None = None
    """Seconds that a batch may take, including compilation; with None only the next limit applies."""
    silence_factor: float = 20.0
    silence_floor: float = 300.0
    """Without a time limit the master gives up a worker after this multiple of the time of the slowest batch so far,
    scaled by cost. The second number is the least time, s; ten times as long before any batch is done.
    """
    hard_limit_factor: float = 1.5
    """The hard limit as a multiple of the time limit, larger than 1."""
    watchdog_margin: float = 5.0
    """Seconds that the master waits after the hard limit."""
    stop_grace: float = 60.0
    """Seconds that the master waits for its workers at a regular end; some may be starting."""
    hurry_grace: float = 2.0
    """The same at an end by a signal or an error."""

    def __post_init__(self) -> None:
        if self.time_limit is not None and not self.time_limit > 0.0:
            raise ValueError(f"time_limit is {self.time_limit} s: give more than 0 s, or None for no limit")
        if not self.hard_limit_factor > 1.0:
            raise ValueError(
                f"hard_limit_factor is {self.hard_limit_factor}: give more than 1; the batch must have time"
                " to notice its own limit first"
            )
        for name in ("watchdog_margin", "stop_grace", "hurry_grace"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} is {getattr(self, name)} s: give 0 s or more")

    @property
    def hard_limit(self) -> float | None:
        """Seconds after which the kernel kills a worker that still computes the same batch."""
        return None if self.time_limit is None else self.time_limit * self.hard_limit_factor

    @property
    def watchdog_limit(self) -> float | None:
        """Seconds after which the master gives up a worker that still computes the same batch."""
        return None if self.hard_limit is None else self.hard_limit + self.watchdog_margin

    def patience(self, cost: float, slowest: float) -> float:
        """Seconds after which a worker that computes a batch of this cost is given up.

        `slowest` is the longest time of a batch so far, in seconds per unit of cost; 0 before any is done.
        """
        if self.watchdog_limit is not None:
            return self.watchdog_limit
        return max(self.silence_floor, self.silence_factor * slowest * cost) if slowest else 10.0 * self.silence_floor
