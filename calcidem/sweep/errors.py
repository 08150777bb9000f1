"""Errors of a sweep."""


class SweepError(Exception):
    """Base class of what can go wrong with a sweep as a whole."""


class LaunchError(SweepError):
    """The program was started in a way in which it cannot work as asked."""


class MasterLostError(SweepError):
    """Rank 0 has died; a worker alone can do nothing more."""
