"""The time limit of a batch, checked by the computation itself between chunks of work."""

import time
from collections.abc import Callable


class TimeLimitReached(Exception):  # noqa: N818 - an expected end of a computation, not an error of the program
    """The batch has used up its time; becomes the failure `timed_out`."""


class SweepInterrupted(BaseException):
    """The sweep ends now and drops the batch; not an Exception, so that a computation doesn't swallow it."""


class Deadline:
    """What a computation calls every 0.1 to 0.5 s, between chunks of compiled work.

    A signal handler or a time limit written in Python cannot interrupt compiled code, so the
    computation has to ask.

    Parameters
    ----------
    time_limit
        Seconds from now after which a call raises, or None for no limit.
    interrupted
        Tells whether the sweep has been told to end at once.
    """

    def __init__(self, time_limit: float | None, interrupted: Callable[[], bool]) -> None:
        self._time_limit = time_limit
        self._interrupted = interrupted
        self._start = time.monotonic()

    def __call__(self) -> None:
        """Return if there is time left.

        Raises
        ------
        TimeLimitReached
            If the batch has used up its time.
        SweepInterrupted
            If the sweep has been told to end at once.
        """
        if self._interrupted():
            raise SweepInterrupted
        elapsed = time.monotonic() - self._start
        if self._time_limit is not None and elapsed > self._time_limit:
            raise TimeLimitReached(
                f"not finished after {elapsed:.1f} s, the time limit of a batch is {self._time_limit:g} s"
            )
