"""All records that callers of the store give and get, in one place.

They are frozen and hold SI units (contents in percent of the sand's mass). A missing number is None, never NaN. The
outcome of a cell is its `CellStatus`.
"""

from calcidem.ends import CellStatus
from calcidem.storage.records.campaign import CampaignRecord, PackingRecord
from calcidem.storage.records.cell import (
    ARRAY_RECORDS,
    EXACT_QUANTITIES,
    LARGEST_SEED,
    NOT_PLANNED,
    QUANTITY_BY_NAME,
    STATUS_CODES,
    STORED_STATUSES,
    AttemptCount,
    AttemptRecord,
    CellKey,
    CellResult,
    PackedResult,
    canonical_content,
    checked_seed,
)
from calcidem.storage.records.quantity import Quantity
from calcidem.storage.records.run import RunRecord
from calcidem.storage.records.sample import (
    C_CONTACT,
    P_CONTACT,
    CementPattern,
    GrainPath,
    NetworkFeatures,
    PathFeatures,
    RecordedSection,
)

__all__ = [
    "ARRAY_RECORDS",
    "C_CONTACT",
    "EXACT_QUANTITIES",
    "LARGEST_SEED",
    "NOT_PLANNED",
    "P_CONTACT",
    "QUANTITY_BY_NAME",
    "STATUS_CODES",
    "STORED_STATUSES",
    "AttemptCount",
    "AttemptRecord",
    "CampaignRecord",
    "CellKey",
    "CellResult",
    "CellStatus",
    "CementPattern",
    "GrainPath",
    "NetworkFeatures",
    "PackedResult",
    "PackingRecord",
    "PathFeatures",
    "Quantity",
    "RecordedSection",
    "RunRecord",
    "canonical_content",
    "checked_seed",
]
