import os
import signal

import pytest

from calcidem.sweep.signals import StopLevel, StopRequest


def send(number: signal.Signals) -> None:
    """Send this process a signal; Python runs the handler before the next line."""
    os.kill(os.getpid(), number)


def test_nothing_is_requested_without_a_signal() -> None:
    """A fresh request asks for nothing."""
    with StopRequest() as request:
        assert (request.level, request.hurry(), request.reason) == (StopLevel.NONE, False, "")


def test_sigusr1_asks_to_finish_what_runs() -> None:
    """SIGUSR1, however often, is a request without hurry."""
    with StopRequest() as request:
        send(signal.SIGUSR1)
        send(signal.SIGUSR1)
        assert (request.level, request.hurry(), request.reason) == (StopLevel.DRAIN, False, "SIGUSR1")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGUSR2])
def test_urgent_signals_ask_to_hurry(number: signal.Signals) -> None:
    """SIGTERM, SIGINT and SIGUSR2 raise the level, also after SIGUSR1, and SIGUSR1 does not lower it."""
    with StopRequest() as request:
        send(signal.SIGUSR1)
        send(number)
        send(signal.SIGUSR1)
        assert (request.level, request.hurry(), request.reason) == (StopLevel.HURRY, True, number.name)
        assert ("Ctrl-C" in request.explanation) == (number == signal.SIGUSR2)


def test_the_same_signal_twice_in_a_row_is_one_request() -> None:
    """A batch system and mpirun may both pass a SIGTERM on: within a second that is one request."""
    called = []
    with StopRequest(end_at_once=lambda: called.append(1)) as request:
        send(signal.SIGTERM)
        send(signal.SIGTERM)
        assert request.hurry()
    assert called == []
