import os
import signal

import pytest

from calcidem.sweep.schedule import StopLevel, StopRequest


def send(number: signal.Signals) -> None:
    """Send this process a signal; Python runs the handler before the next line."""
    os.kill(os.getpid(), number)


def test_nothing_is_requested_without_a_signal() -> None:
    """A fresh request asks for nothing."""
    with StopRequest() as request:
        assert (request.level, request.hurry(), request.reason) == (StopLevel.NONE, False, "")


def test_sigusr1_asks_to_finish_what_runs() -> None:
    """SIGUSR1, however often, is a request without hurry; a rank that computes takes no notice of it."""
    for finishes, level, reason in ((True, StopLevel.DRAIN, "SIGUSR1"), (False, StopLevel.NONE, "")):
        with StopRequest(finishes=finishes) as request:
            send(signal.SIGUSR1)
            send(signal.SIGUSR1)
            assert (request.level, request.hurry(), request.reason) == (level, False, reason)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR2])
def test_urgent_signals_ask_to_hurry(number: signal.Signals) -> None:
    """SIGTERM, SIGINT, SIGHUP and SIGUSR2 raise the level, also after SIGUSR1, and SIGUSR1 does not lower it."""
    with StopRequest() as request:
        send(signal.SIGUSR1)
        send(number)
        send(signal.SIGUSR1)
        assert (request.level, request.hurry(), request.reason) == (StopLevel.HURRY, True, number.name)
        assert ("Ctrl-C" in request.explanation) == (number == signal.SIGUSR2)


def test_the_same_signal_twice_in_a_row_is_one_request() -> None:
    """A batch system and mpirun may both pass a SIGTERM on: within a second that is one request."""
    with StopRequest() as request:
        send(signal.SIGTERM)
        send(signal.SIGTERM)
        assert request.hurry()


def test_a_sigterm_after_the_death_of_a_rank_is_no_request_of_a_user() -> None:
    """The launcher then ends all ranks; other signals come from users."""
    for number, level in ((signal.SIGTERM, StopLevel.LOST), (signal.SIGUSR2, StopLevel.HURRY)):
        with StopRequest() as request:
            request.has_lost = lambda: True
            send(number)
            assert request.level is level
            assert request.hurry()


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_is_ignored_stays_ignored(number: signal.Signals) -> None:
    """`nohup` and a shell's `&` ignore signals for their programs."""
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with StopRequest() as request:
            send(number)
            assert request.level is StopLevel.NONE
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)
