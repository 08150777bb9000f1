"""What a campaign needs of a machine, each point checked by trying it out."""

from dataclasses import dataclass
from enum import StrEnum


class FindingLevel(StrEnum):
    """How good a finding is: with a warning a campaign runs slower or less safely, with a problem not as it should."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"


OK, WARNING, PROBLEM = FindingLevel


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check of the machine found: one line of the report."""

    level: FindingLevel
    subject: str
    fact: str
    """How good it is, what was looked at, and what was found."""
    cure: str = ""
    """What to do about it; empty if all is well."""
