"""Ends of a cell: one vocabulary for simulation, scheduler, store and displays, which do not import each other."""

from enum import StrEnum
from typing import Self


class CellStatus(StrEnum):
    """Status of a cell; the values are stored."""

    PENDING = "pending"
    """It has no outcome yet; this is never stored."""
    RUNNING = "running"
    """The same, while it is computed: an attempt has begun."""
    DONE = "done"
    """It has a velocity."""
    NO_ARRIVAL = "no_arrival"
    """The simulation is right, but no velocity can be read from it."""
    UNSTABLE = "unstable"
    """A guard ended the simulation."""
    FAILED = "failed"
    """The computation raised an exception."""
    TIMED_OUT = "timed_out"
    """The computation reached the time limit of a batch."""
    QUARANTINED = "quarantined"
    """Three runs died while it was computed, so it is not tried again."""

    @property
    def words(self) -> str:
        """The status as messages name it."""
        return self.value.replace("_", " ")


DECIDED_BY_PHYSICS = (CellStatus.DONE, CellStatus.NO_ARRIVAL, CellStatus.UNSTABLE)
"""Outcomes that a new computation would repeat; the others depend on the machine."""


class Verdict(StrEnum):
    """Reason why a section gives no velocity, and its remedy.

    A cell stores the value of a member, a colon, and numbers (`calcidem.dem.wave.reading.describe_refusal`).
    """

    remedy: str
    """Values of the configuration that may give a velocity."""

    def __new__(cls, sentence: str, remedy: str) -> Self:  # noqa: D102 - each member is a sentence and its remedy
        member = str.__new__(cls, sentence)
        member._value_ = sentence
        member.remedy = remedy
        return member

    SILENT = (
        "no motion above 0.1 % of v0 arrived",
        'wave.transmitter = "driven", a larger wave.transmitter_half_width, less wave.damping',
    )
    TOO_SHORT = "the record ends before the S wave is certain", "a smaller wave.slowest"
    NO_PEAK = (
        "the receiver has no peak within half a period of the fitted wave",
        'wave.frequency = "auto" (2.5 wavelengths on the path), a larger wave.listening_depth or receiver_half_width',
    )
    UNCERTAIN = (
        "the standard error of the reading is above pick.largest_error",
        'wave.frequency = "auto" (2.5 wavelengths on the path), a wider box, a larger pick.largest_error',
    )
    INACCURATE = (
        "the check samples of this content do not confirm its velocities",
        'a smaller wave.step_fraction, wave.damping or wave.amplitude, wave.law = "finite", wave.precision = "float64"',
    )

    @property
    def explained(self) -> str:
        """The reason with its remedy, as tables and messages have it."""
        return f"{self}; remedy: {self.remedy}"

    @classmethod
    def of(cls, reason: str) -> Self | None:
        """Verdict of a stored reason; None for other reasons, which name their remedy."""
        sentence, _, _ = reason.partition(":")
        return next((verdict for verdict in cls if verdict == sentence), None)
