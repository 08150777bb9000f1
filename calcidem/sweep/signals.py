"""Signals as requests to stop: recorded by the handler, followed by the loop that polls them."""

import os
import signal
import time
from collections.abc import Callable, Mapping
from enum import IntEnum
from types import FrameType
from typing import Any, Self

from calcidem.sweep.sweep_end import EXIT_RESUMABLE


def _known(*names: str) -> tuple[signal.Signals, ...]:
    """Those of these signals that this system has; Windows lacks most."""
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


_DRAIN_SIGNALS = ("SIGUSR1",)
"""Finish the running batches, store them, then stop."""

# mpirun forwards SIGUSR2 to its ranks and waits for them, while on SIGTERM it kills them 0.25 s later and
# returns 1; so a launcher script that passes its own SIGTERM on as SIGUSR2 gets an orderly end.
_RELAYED_AS = "SIGUSR2"
_HURRY_SIGNALS = ("SIGTERM", "SIGINT", _RELAYED_AS)
"""Store finished batches and stop now; the running ones are dropped."""

_REPEAT_IGNORED = 1.0
"""Seconds within which a repeated signal counts as the same request; a batch system and mpirun may both forward it."""


class StopLevel(IntEnum):
    """Urgency of a requested end."""

    NONE = 0
    DRAIN = 1
    HURRY = 2


class SignalHandlers:
    """Context manager that handles signals and restores the former handlers; for the main thread only.

    Signals are given by their names; those that this system lacks are left out.
    """

    def __init__(self, handlers: Mapping[str, Callable[[int, FrameType | None], None]]) -> None:
        self._handlers: Mapping[signal.Signals, Any] = {
            number: handler for name, handler in handlers.items() for number in _known(name)
        }

    def __enter__(self) -> Self:
        """Install the handlers."""
        self._swap()
        return self

    def __exit__(self, *exception: object) -> None:
        """Restore the former handlers."""
        self._swap()

    def _swap(self) -> None:
        self._handlers = {number: signal.signal(number, handler) for number, handler in self._handlers.items()}


class StopRequest(SignalHandlers):
    """Context manager that turns signals into a level of urgency to be polled.

    A second urgent signal, at least `_REPEAT_IGNORED` after the first, ends the process at once. Before that,
    ``end_at_once`` is called.

    Attributes
    ----------
    level
        Urgency of a requested end.    reason
        Name of the signal that requested it, empty if none.
    """

    def __init__(self, end_at_once: Callable[[], object] | None = None) -> None:
        super().__init__(dict.fromkeys(_DRAIN_SIGNALS, self._drain) | dict.fromkeys(_HURRY_SIGNALS, self._hurry))
        self._end_at_once = end_at_once
        self._hurry_since: float | None = None
        self.level = StopLevel.NONE
        self.reason = ""

    @property
    def explanation(self) -> str:
        """Reason in words for the user; SIGUSR2 stands for another signal of the user."""
        relayed = self.reason == _RELAYED_AS
        return f"SIGTERM or Ctrl-C, passed on as {self.reason}" if relayed else self.reason

    def hurry(self) -> bool:
        """Whether the running batches have to be dropped."""
        return self.level is StopLevel.HURRY

    def _drain(self, number: int, _frame: FrameType | None) -> None:
        if self.level is StopLevel.NONE:
            self.level = StopLevel.DRAIN
            self.reason = signal.Signals(number).name

    def _hurry(self, number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if self._hurry_since is None:
            self._hurry_since = now
            self.level = StopLevel.HURRY
            self.reason = signal.Signals(number).name
        elif now - self._hurry_since > _REPEAT_IGNORED:
            if self._end_at_once is not None:
                self._end_at_once()
            os._exit(EXIT_RESUMABLE)


def leave_signals_to_master() -> None:
    """Ignore all signals that request a stop: mpirun sends them to every rank, but rank 0 alone decides."""
    for number in _known(*_DRAIN_SIGNALS, *_HURRY_SIGNALS):
        signal.signal(number, signal.SIG_IGN)
