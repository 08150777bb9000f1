"""What a check of the machine found."""

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How good a finding is."""

    OK = "ok"
    WARNING = "warning"
    """A campaign runs, but slower or less safely than it could."""
    PROBLEM = "problem"
    """A campaign will not run as it should."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the check.

    Attributes
    ----------
    verdict
        How good it is.
    subject
        What was looked at.
    fact
        What was found.
    cure
        What to do about it; empty if all is well.
    """

    verdict: Verdict
    subject: str
    fact: str
    cure: str = ""
