"""The packing of a campaign: where it comes from, and how it is kept as bytes and as a record of the store."""

import io
import json
import os
from collections.abc import Callable
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import numpy as np

from calcidem.app.config.schema import Configuration
from calcidem.dem.engine.scene import Preload
from calcidem.dem.sample.packing import WALL_NAMES, Packing, PackingReport, make_packing
from calcidem.dem.sample.packing_file import PackingFileError, packing_from_csv
from calcidem.dem.sample.random_streams import RandomPurpose, random_generator
from calcidem.storage.files import write_atomically
from calcidem.storage.records import PackingRecord
from calcidem.storage.store import Store

CACHE_VARIABLE = "CALCIDEM_CACHE"
"""Names the folder of the cache, if it is not to be ``$XDG_CACHE_HOME/calcidem``."""

HEADING = b"calcidem packing 1\n"
DIGEST_LENGTH = 64

Tell = Callable[[str], None]


class DamagedPackingError(ValueError):
    """Bytes that are not, or no longer, what `packing_to_bytes` gave."""


def cache_folder() -> Path:
    """Folder in which packings are kept between campaigns; need not exist yet."""
    own = os.environ.get(CACHE_VARIABLE)
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "calcidem"


def provide_packing(
    configuration: Configuration, store: Store | None, tell: Tell, check: Callable[[], None] = lambda: None
) -> Packing:
    """The packing of a campaign, made only if neither its database nor the cache has it.

    Parameters
    ----------
    configuration
        Of the campaign.
    store
        Its database with the campaign chosen, if there is one already.
    tell
        Takes sentences for the user.
    check
        Called every fraction of a second while it is made; may raise to end that.

    Raises
    ------
    PackingError
        If it has to be made and does not come to rest.
    """
    record = store.load_packing() if store is not None else None
    if record is not None and record.hash == configuration.packing_hash and record.state:
        tell("Packing: taken from the database.")
        return stored_packing(record)
    path = cache_folder() / f"packing-{configuration.packing_hash[:32]}.npz"
    packing = read_cache(path, tell)
    if packing is not None:
        tell(f"Packing: taken from the cache, {path}.")
        return packing
    draw = configuration.packing_draw
    if draw.file is not None:
        tell(f"Packing: the disks in {draw.file} are brought to rest; this is done once.")
        packing = packing_of_own_disks(configuration, check)
    else:
        tell("Packing: being made; this is done once and takes about half a minute for 4,700 disks.")
        generator = random_generator(configuration.campaign.root_seed, draw.seed, RandomPurpose.DISKS)
        packing = make_packing(configuration.packing, configuration.sand, generator, check)
    write_cache(path, packing, tell)
    return packing


def read_cache(path: Path, tell: Tell) -> Packing | None:
    """Packing in a file of the cache; None if there is none that is whole."""
    try:
        return packing_from_bytes(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, DamagedPackingError) as error:
        tell(f"Packing: the cached {path} is damaged ({error}); making it again.")
        return None


def write_cache(path: Path, packing: Packing, tell: Tell) -> None:
    """Put a packing into the cache in one step; a cache that cannot be written costs time later, nothing else."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as temporary:
            temporary.write_bytes(packing_to_bytes(packing))
    except OSError as error:
        cure = f"set {CACHE_VARIABLE} to a folder that works"
        tell(f"Packing: not kept in the cache {path.parent} ({error.strerror}); {cure}.")


def packing_of_own_disks(configuration: Configuration, check: Callable[[], None]) -> Packing:
    """Make the packing of the disks in the configuration's file.

    Raises
    ------
    PackingFileError
        If the file is no longer the one that was looked at.
    PackingError
        If the disks do not come to rest.
    """
    draw = configuration.packing_draw
    path = Path(str(draw.file))
    if sha256(path.read_bytes()).hexdigest() != draw.file_sha256:
        raise PackingFileError(f"{path} was changed while the campaign began; run the command again")
    return packing_from_csv(path, configuration.sand, configuration.packing, check)


def packing_to_bytes(packing: Packing) -> bytes:
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


def packing_from_bytes(archive: bytes) -> Packing:
    """Packing that `packing_to_bytes` was given, bit for bit.

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
        mean_relative_overlap=report.mean_overlap / diameter,
        largest_relative_overlap=report.largest_overlap / diameter,
        unbalanced_ratio=report.unbalanced_ratio,
        seconds=report.seconds,
        state=packing_to_bytes(packing),
    )


def stored_packing(record: PackingRecord) -> Packing:
    """Packing of a record, bit for bit the one that was stored.

    Raises
    ------
    DamagedPackingError
        If the record's state is missing or damaged.
    """
    return packing_from_bytes(record.state)
