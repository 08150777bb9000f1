"""Packings in store and cache, as bytes and as records; reading never makes a packing."""

import io
import json
import os
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import numpy as np

from calcidem.dem.engine.scene import Preload
from calcidem.dem.sample.packing import WALL_NAMES, Packing, PackingReport
from calcidem.storage.errors import DamagedStoreError
from calcidem.storage.records import PackingRecord

CACHE_VARIABLE = "CALCIDEM_CACHE"
"""Variable with the folder of the cache, instead of ``$XDG_CACHE_HOME/calcidem``."""

_HEADING = b"calcidem packing 1\n"
_DIGEST_LENGTH = 64


class DamagedPackingError(ValueError):
    """Bytes that `packing_to_bytes` did not make, or that were changed."""


def cache_folder() -> Path:
    """Folder of packings for later campaigns; it may not exist yet."""
    own, shared = os.environ.get(CACHE_VARIABLE), os.environ.get("XDG_CACHE_HOME")
    return Path(own) if own else Path(shared or Path.home() / ".cache") / "calcidem"


def packing_to_bytes(packing: Packing) -> bytes:
    """Header, SHA-256 of the rest, and arrays and report in NumPy's npz format."""
    body = io.BytesIO()
    np.savez(
        body,
        x=packing.x,
        y=packing.y,
        radius=packing.radius,
        size=np.array([packing.width, packing.height]),
        pairs=packing.preload.pairs,
        shear=packing.preload.shear,
        report=np.frombuffer(json.dumps(asdict(packing.report)).encode(), dtype=np.uint8),
    )
    digest = sha256(body.getvalue()).hexdigest().encode()
    return _HEADING + digest + b"\n" + body.getvalue()


def packing_from_bytes(archive: bytes) -> Packing:
    """Packing from the bytes of `packing_to_bytes`, bit for bit.

    `DamagedPackingError` if the bytes were changed or truncated, or are something else.
    """
    if not archive or not isinstance(archive, bytes):  # a damaged database may give a text
        raise DamagedPackingError("it is empty, or a text")
    start = len(_HEADING) + _DIGEST_LENGTH + 1
    head, body = archive[:start], archive[start:]
    if head != _HEADING + sha256(body).hexdigest().encode() + b"\n":
        raise DamagedPackingError("the checksum does not fit")
    with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
        report = json.loads(arrays["report"].tobytes())
        width, height = (float(length) for length in arrays["size"])
        return Packing(
            x=arrays["x"],
            y=arrays["y"],
            radius=arrays["radius"],
            width=width,
            height=height,
            preload=Preload(arrays["pairs"], arrays["shear"]),
            report=PackingReport(**report | {"wall_stress": tuple(report["wall_stress"])}),
        )


def packing_record(packing: Packing, *, index: int, packing_hash: str) -> PackingRecord:
    """Record of packing and report for the store, where overlaps are relative to the mean diameter."""
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
        mean_relative_overlap=report.mean_overlap / diameter,
        largest_relative_overlap=report.largest_overlap / diameter,
        unbalanced_ratio=report.unbalanced_ratio,
        seconds=report.seconds,
        state=packing_to_bytes(packing),
        content_hash=packing.content_hash,
    )


def stored_packing(record: PackingRecord) -> Packing:
    """Packing of a record, bit for bit the stored one.

    `DamagedStoreError` if the record's state is missing or damaged, or belongs to another packing than the record.
    """
    try:
        packing = packing_from_bytes(record.state)
        _check_record(record, packing)
    except DamagedPackingError as error:
        raise DamagedStoreError(
            f"The stored state of packing {record.index} can't be used: {error}.",
            "The results can be read as before. 'calcidem import' of an earlier export gets it back.",
        ) from error
    return packing


def _check_record(record: PackingRecord, packing: Packing) -> None:
    """Raise `DamagedPackingError` if a record contradicts the packing in its state."""
    for name in ("x", "y", "radius", "width", "height"):
        if not np.array_equal(getattr(packing, name), getattr(record, name)):
            raise DamagedPackingError(f"its {name} is not that of the record")
    if record.content_hash != packing.content_hash:
        raise DamagedPackingError(f"its content hash is {packing.content_hash}, not {record.content_hash}")
