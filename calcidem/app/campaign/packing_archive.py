"""A packing as bytes and back, bit for bit, with a checksum."""

import io
import json
from dataclasses import asdict
from hashlib import sha256

import numpy as np

from calcidem.dem.engine.state import Preload
from calcidem.dem.sample.packing import Packing, PackingReport

HEADING = b"calcidem packing 1\n"
DIGEST_LENGTH = 64


class DamagedPackingError(ValueError):
    """Bytes that are not, or not any more, what `to_bytes` gave."""


def to_bytes(packing: Packing) -> bytes:
    """Heading, SHA-256 of the rest, and the arrays and the report in NumPy's npz format."""
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
    return HEADING + digest + b"\n" + body.getvalue()


def from_bytes(archive: bytes) -> Packing:
    """Packing that `to_bytes` was given.

    Raises
    ------
    DamagedPackingError
        If the bytes have been changed or cut off, or are something else.
    """
    start = len(HEADING) + DIGEST_LENGTH + 1
    head, body = archive[:start], archive[start:]
    if head != HEADING + sha256(body).hexdigest().encode() + b"\n":
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
