"""The packing of a campaign: where it comes from, and how it is kept as bytes and as a record of the store."""

import io
import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from calcidem.app.config.presets import preset_packing, preset_packings
from calcidem.app.config.schema import Configuration
from calcidem.dem.engine.scene import Preload
from calcidem.dem.sample.packing import (
    PACKING_METHOD,
    WALL_NAMES,
    Packing,
    PackingReport,
    PackingStage,
    make_packing,
)
from calcidem.dem.sample.packing_file import PackingFileError, packing_from_csv
from calcidem.dem.sample.random_streams import RandomPurpose, random_generator
from calcidem.storage.errors import DamagedStoreError, OutputRefusedError
from calcidem.storage.files import write_atomically
from calcidem.storage.records import PackingRecord
from calcidem.storage.sql.store import Store

CACHE_VARIABLE = "CALCIDEM_CACHE"
"""Names the folder of the cache, if it is not to be ``$XDG_CACHE_HOME/calcidem``."""

_HEADING = b"calcidem packing 1\n"
_DIGEST_LENGTH = 64

Tell = Callable[[str], None]


class DamagedPackingError(ValueError):
    """Bytes that are not, or no longer, what `packing_to_bytes` gave."""


def cache_folder() -> Path:
    """Folder in which packings are kept between campaigns; need not exist yet."""
    if own := os.environ.get(CACHE_VARIABLE):
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "calcidem"


def provide_packing(
    configuration: Configuration,
    store: Store | None,
    tell: Tell,
    check: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """The packing of a campaign: of its database, of calcidem itself, or of the cache; made only if none has it.

    A packing whose stored state is damaged is replaced by one of the same content, and by no other.

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
    watch
        Told as often how far that is.

    Raises
    ------
    PackingError
        If it has to be made and does not come to rest.
    CampaignMismatchError
        If the stored one is damaged and what is found or made is another one.
    """
    if store is None or 0 not in store.packing_indices():
        return _find_packing(configuration, tell, check, watch)
    try:
        packing = _stored_packing(store.packing())
    except DamagedStoreError as error:
        tell(f"Packing: {error.problem}")
    else:
        tell("Packing: taken from the database.")
        return packing
    packing = _find_packing(configuration, tell, check, watch)
    store.save_packing(packing_record(packing, index=0, packing_hash=configuration.packing_hash), replace_state=True)
    tell("Packing: it is the same, and the one in the database has been replaced.")
    return packing


def readable_packing(store: Store, index: int) -> Packing:
    """The stored packing; where it is damaged the same one, by its content hash, of calcidem or of the cache.

    Raises
    ------
    DamagedStoreError
        If it is damaged, and nobody else has it.
    UnknownCellError
        If there is none of that index.
    """
    try:
        return _stored_packing(store.packing(index))
    except DamagedStoreError:
        content_hash = store.content_hashes().get(index)
        cached = sorted(cache_folder().glob("packing-*.npz"))
        for archive in (*preset_packings(), *cached):
            with suppress(OSError, DamagedPackingError):
                found = packing_from_bytes(archive.read_bytes())
                if found.content_hash == content_hash:
                    return found
        raise


def _find_packing(
    configuration: Configuration, tell: Tell, check: Callable[[], None], watch: Callable[[PackingStage], None]
) -> Packing:
    """The packing that comes with calcidem or is in the cache, or else a new one; see `provide_packing`."""
    packing = kept_packing(configuration.packing_hash, tell)
    if packing is not None:
        return packing
    packing = new_packing(configuration, tell, check, watch)
    _write_cache(cache_folder() / _cached_name(configuration.packing_hash), packing, tell)
    return packing


def new_packing(
    configuration: Configuration,
    tell: Tell,
    check: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """The packing of a configuration made anew, whatever is kept; see `provide_packing`."""
    draw = configuration.packing_draw
    if draw.file is not None:
        tell(f"Packing: the disks in {draw.file} are brought to rest; this is done once.")
        return _packing_of_own_disks(configuration, check, watch)
    tell("Packing: being made; this is done once and takes about a quarter of a minute for 4,700 disks.")
    generator = random_generator(configuration.campaign.root_seed, draw.seed, RandomPurpose.DISKS)
    return make_packing(configuration.packing, configuration.sand, generator, check, watch)


def kept_packing(packing_hash: str, tell: Tell) -> Packing | None:
    """The packing that comes with calcidem or is in the cache; None if neither has it."""
    archive = preset_packing(packing_hash)
    if archive is not None:
        tell("Packing: comes with calcidem.")
        return packing_from_bytes(archive)
    path = cache_folder() / _cached_name(packing_hash)
    packing = _read_cache(path, tell)
    if packing is not None:
        tell(f"Packing: taken from the cache, {path}.")
    return packing


def _cached_name(packing_hash: str) -> str:
    """Name in the cache of the packing with this `Configuration.packing_hash`, as the present method makes it."""
    return f"packing-{PACKING_METHOD}-{packing_hash[:32]}.npz"


def _read_cache(path: Path, tell: Tell) -> Packing | None:
    """Packing in a file of the cache; None if there is none that is whole."""
    try:
        return packing_from_bytes(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, DamagedPackingError) as error:
        tell(f"Packing: the cached {path} is damaged ({error}); making it again.")
        return None


def _write_cache(path: Path, packing: Packing, tell: Tell) -> None:
    """Put a packing into the cache in one step; a cache that cannot be written costs time later, nothing else."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as temporary:
            temporary.write_bytes(packing_to_bytes(packing))
    except (OSError, OutputRefusedError) as error:
        cure = f"set {CACHE_VARIABLE} to a folder that works"
        why = error.strerror if isinstance(error, OSError) else f"{path.name} is no packing's file"
        tell(f"Packing: not kept in the cache {path.parent} ({why}); {cure}.")


def _packing_of_own_disks(
    configuration: Configuration, check: Callable[[], None], watch: Callable[[PackingStage], None]
) -> Packing:
    """Make the packing of the disks in the configuration's file, unless that was changed meanwhile."""
    draw = configuration.packing_draw
    path = Path(str(draw.file))
    if sha256(path.read_bytes()).hexdigest() != draw.file_sha256:
        raise PackingFileError(f"{path} was changed while the campaign began; run the command again")
    return packing_from_csv(path, configuration.sand, configuration.packing, check, watch)


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
    return _HEADING + digest + b"\n" + body.getvalue()


def packing_from_bytes(archive: bytes) -> Packing:
    """Packing that `packing_to_bytes` was given, bit for bit.

    Raises
    ------
    DamagedPackingError
        If the bytes have been changed or cut off, or are something else.
    """
    if not archive:
        raise DamagedPackingError("it is empty")
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
        content_hash=packing.content_hash,
    )


def _stored_packing(record: PackingRecord) -> Packing:
    """Packing of a record, bit for bit the one that was stored.

    Raises
    ------
    DamagedStoreError
        If the record's state is missing or damaged, or of another packing than the rest of the record.
    """
    try:
        packing = packing_from_bytes(record.state)
        _check_record(record, packing)
    except DamagedPackingError as error:
        raise DamagedStoreError(
            f"The stored state of packing {record.index} can't be used: {error}.",
            "Samples can't be rebuilt from it; the results can be read as before.",
        ) from error
    return packing


def _check_record(record: PackingRecord, packing: Packing) -> None:
    """Raise `DamagedPackingError` if a record says something else than the packing in its state."""
    for name in ("x", "y", "radius", "width", "height"):
        if not np.array_equal(getattr(packing, name), getattr(record, name)):
            raise DamagedPackingError(f"its {name} is not that of the record")
    if record.content_hash not in {None, packing.content_hash}:
        raise DamagedPackingError(f"its content hash is {packing.content_hash}, not {record.content_hash}")


def identify_packing(record: PackingRecord) -> PackingRecord:
    """A record whose state, if there is one, was checked, with the content hash that an earlier calcidem did not store.

    Raises
    ------
    DamagedStoreError
        As `_stored_packing`.
    """
    return replace(record, content_hash=_stored_packing(record).content_hash) if record.state else record


def content_hash_of(record: PackingRecord) -> str | None:
    """Content hash of a stored packing, also of one that an earlier calcidem stored; None where that can't be told."""
    with suppress(DamagedStoreError):
        record = identify_packing(record)
    return record.content_hash
