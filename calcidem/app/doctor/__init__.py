"""What a campaign needs of a machine, each point checked by trying it out."""

from dataclasses import dataclass
from enum import StrEnum


class FindingLevel(StrEnum):
    """How good a finding is."""

    OK = "ok"
    WARNING = "warning"
    """A campaign runs, but slower or less safely than it could."""
    PROBLEM = "problem"
    """A campaign will not run as it should."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check of the machine found: one line of the report.

    Attributes
    ----------
    level
        How good it is.
    subject
        What was looked at.
    fact
        What was found.
    cure
        What to do about it; empty if all is well.
    """

    level: FindingLevel
    subject: str
    fact: str
    cure: str = ""
