"""A packing as the store keeps it, and back."""

from calcidem.app.campaign.packing_archive import from_bytes, to_bytes
from calcidem.dem.sample.packing import WALL_NAMES, Packing
from calcidem.storage.records import PackingRecord


def packing_record(packing: Packing, *, index: int, packing_hash: str) -> PackingRecord:
    """Packing and report as the store keeps them; there, overlaps are relative to the mean diameter."""
    report = packing.report
    diameter = 2.0 * float(packing.radius.mean())
    return PackingRecord(
        index=index,
        hash=packing_hash,
        x=packing.x.astype(float),
        y=packing.y.astype(float),
        radius=packing.radius.astype(float),
        width=packing.width,
        height=packing.height,
        porosity=report.porosity,
        coordination_number=report.coordination_number,
        coordination_number_without_rattlers=report.coordination_number_without_rattlers,
        wall_stress=dict(zip(WALL_NAMES, report.wall_stress, strict=True)),
        mean_overlap=report.mean_overlap / diameter,
        largest_overlap=report.largest_overlap / diameter,
        unbalanced_ratio=report.unbalanced_ratio,
        seconds=report.seconds,
        state=to_bytes(packing),
    )


def stored_packing(record: PackingRecord) -> Packing:
    """Packing of a record, bit for bit the one that was stored.

    Raises
    ------
    DamagedPackingError
        If the record's state is missing or damaged.
    """
    return from_bytes(record.state)
