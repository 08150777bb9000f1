"""All records that callers of the store give and get, in one place.

They are frozen, hold SI units (contents in percent of the sand's mass), and a missing number is None, never
NaN; what happened to a cell is its `CellStatus`.
"""

from calcidem.storage.records.campaign import CampaignRecord, PackingRecord, RunRecord, WorkerRecord
from calcidem.storage.records.cell import (
    LARGEST_SEED,
    NOT_PLANNED,
    STATUS_CODES,
    STORED_STATUSES,
    AttemptCount,
    AttemptRecord,
    CellKey,
    CellResult,
    CellStatus,
    PackedResult,
    canonical_content,
    checked_seed,
)
from calcidem.storage.records.sample import C_CONTACT, P_CONTACT, CementPattern, GraphSummary, PathFeatures, Signal

__all__ = [
    "C_CONTACT",
    "LARGEST_SEED",
    "NOT_PLANNED",
    "P_CONTACT",
    "STATUS_CODES",
    "STORED_STATUSES",
    "AttemptCount",
    "AttemptRecord",
    "CampaignRecord",
    "CellKey",
    "CellResult",
    "CellStatus",
    "CementPattern",
    "GraphSummary",
    "PackedResult",
    "PackingRecord",
    "PathFeatures",
    "RunRecord",
    "Signal",
    "WorkerRecord",
    "canonical_content",
    "checked_seed",
]
