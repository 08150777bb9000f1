"""Packing of a campaign: from its database, from calcidem itself, from the cache, or made; as bytes and as a record."""

import io
import json
import os
from collections.abc import Callable
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calcidem.app.campaign.notices import tell
from calcidem.app.config.presets import preset_packings
from calcidem.app.config.schema import Configuration
from calcidem.dem.engine.scene import Preload
from calcidem.dem.sample.cement import RandomPurpose, random_generator
from calcidem.dem.sample.packing import (
    PACKING_METHOD,
    WALL_NAMES,
    Packing,
    PackingFileError,
    PackingReport,
    PackingStage,
    refuse_changed,
)
from calcidem.input_file import MOST_BYTES, InputFileError, read_input
from calcidem.storage.errors import DamagedStoreError, OutputRefusedError
from calcidem.storage.files import write_atomically
from calcidem.storage.records import PackingRecord, unpack_arrays

if TYPE_CHECKING:
    from calcidem.storage.sql.store import Store  # which the ranks do not need

CACHE_VARIABLE = "CALCIDEM_CACHE"
"""Variable with the folder of the cache, instead of ``$XDG_CACHE_HOME/calcidem``."""


class DamagedPackingError(ValueError):
    """Bytes that `packing_to_bytes` did not make for this configuration, or that were changed."""


def cache_folder() -> Path:
    """Folder of packings for later campaigns; it may not exist yet."""
    own, shared = os.environ.get(CACHE_VARIABLE), os.environ.get("XDG_CACHE_HOME")
    return Path(own) if own else Path(shared or Path.home() / ".cache") / "calcidem"


def _heading(packing_hash: str) -> bytes:
    return f"calcidem packing 1 {packing_hash}".rstrip().encode()


def packing_to_bytes(packing: Packing, packing_hash: str = "") -> bytes:
    """Heading, SHA-256 of the rest, and arrays and report in NumPy's npz format.

    The heading of a file states the configuration's `packing_hash`, for which a database has a column.
    """
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
    return b"\n".join((_heading(packing_hash), sha256(body.getvalue()).hexdigest().encode(), body.getvalue()))


def packing_from_bytes(archive: bytes, packing_hash: str = "") -> Packing:
    """Packing from the bytes of `packing_to_bytes`, bit for bit.

    `DamagedPackingError` if the bytes were changed or truncated, belong to another configuration, or are something
    else, and if the disks do not touch as they state.
    """
    if not archive or not isinstance(archive, bytes):  # a damaged database may give a text
        raise DamagedPackingError("it is empty, or a text")
    head, _, rest = archive.partition(b"\n")
    digest, _, body = rest.partition(b"\n")
    if head != _heading(packing_hash):
        raise DamagedPackingError("it is no packing, or that of another configuration")
    if digest != sha256(body).hexdigest().encode():
        raise DamagedPackingError("the checksum does not fit")
    try:
        arrays = {name: values.copy() for name, values in unpack_arrays(body).items()}  # kernels need writable ones
        report = json.loads(arrays["report"].tobytes())
        width, height = (float(length) for length in arrays["size"])
        packing = Packing(
            x=arrays["x"],
            y=arrays["y"],
            radius=arrays["radius"],
            width=width,
            height=height,
            preload=Preload(arrays["pairs"], arrays["shear"]),
            report=PackingReport(**report | {"wall_stress": tuple(report["wall_stress"])}),
        )
        refuse_changed(packing)
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise DamagedPackingError(f"its content is impossible: {error}") from error
    return packing


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


def stored_packing(record: PackingRecord, packing_hash: str | None = None) -> Packing:
    """Packing of a record, bit for bit the stored one.

    `DamagedStoreError` if the record's state is missing or damaged, or belongs to another packing than the record, and
    if the record belongs to another configuration than that of `packing_hash`.
    """
    try:
        packing = packing_from_bytes(record.state)
        _check_record(record, packing, packing_hash)
    except DamagedPackingError as error:
        raise DamagedStoreError(
            f"The stored state of packing {record.index} can't be used: {error}.",
            "The results can be read as before. 'calcidem import' of an earlier export gets it back.",
        ) from error
    return packing


def _check_record(record: PackingRecord, packing: Packing, packing_hash: str | None) -> None:
    """Raise `DamagedPackingError` if a record contradicts the packing in its state or the configuration."""
    if packing_hash not in {None, record.hash}:
        raise DamagedPackingError("it is that of another configuration")
    for name in ("x", "y", "radius", "width", "height"):
        if not np.array_equal(getattr(packing, name), getattr(record, name)):
            raise DamagedPackingError(f"its {name} is not that of the record")
    if record.content_hash != packing.content_hash:
        raise DamagedPackingError(f"its content hash is {packing.content_hash}, not {record.content_hash}")


def provide_packing(
    configuration: Configuration,
    store: "Store | None",
    raise_if_stopped: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """Packing of a campaign: from its database, from calcidem itself, or from the cache; made only if none has it.

    While a packing is made, ``raise_if_stopped`` is called every fraction of a second and may raise to end it, and
    ``watch`` receives the progress. `PackingError` if it has to be made and does not come to rest, `DamagedStoreError`
    if the stored one is damaged or belongs to another configuration.
    """
    if store is not None and 0 in store.packing_indices():
        return stored_packing(store.packing(), configuration.packing_hash)
    kept = kept_packing(configuration.packing_hash)
    packing = kept or new_packing(configuration, raise_if_stopped, watch)
    if kept is None:
        _write_cache(packing, configuration.packing_hash)
    return packing


def new_packing(
    configuration: Configuration,
    raise_if_stopped: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """New packing of a configuration, without search in storage; see `provide_packing`."""
    from calcidem.dem.sample.compaction import make_packing  # noqa: PLC0415 - the engine, which most commands do not need
    from calcidem.dem.sample.packing_file import packing_from_csv  # noqa: PLC0415 - as above

    draw = configuration.packing_draw
    if draw.file is not None:
        tell(f"Packing: the disks in {draw.file} are brought to rest; this is done once.")
        disks = Path(draw.file)
        if sha256(read_input(disks, MOST_BYTES)).hexdigest() != draw.file_sha256:
            raise PackingFileError(f"{disks} was changed while the campaign began; run the command again")
        return packing_from_csv(disks, configuration.sand, configuration.packing, raise_if_stopped, watch)
    tell("Packing: being made; this is done once.")
    generator = random_generator(configuration.campaign.root_seed, draw.seed, RandomPurpose.DISKS)
    return make_packing(configuration.packing, configuration.sand, generator, raise_if_stopped, watch)


def kept_packing(packing_hash: str) -> Packing | None:
    """Packing from calcidem itself or the cache; None if neither has it."""
    archive = preset_packings().get(packing_hash[:32])
    if archive is not None:
        tell("Packing: comes with calcidem.")
        return packing_from_bytes(archive.read_bytes(), packing_hash)
    path = cache_folder() / _cached_name(packing_hash)
    try:
        packing = packing_from_bytes(read_input(path, MOST_BYTES), packing_hash) if path.exists() else None
    except (OSError, InputFileError, DamagedPackingError) as error:
        tell(f"Packing: the cached {path} is damaged ({error}); making it again.")
        return None
    if packing is not None:
        tell(f"Packing: taken from the cache, {path}.")
    return packing


def _cached_name(packing_hash: str) -> str:
    """File name in the cache of the packing with this `Configuration.packing_hash`, by the present version."""
    return f"packing-{PACKING_METHOD}-{packing_hash[:32]}.npz"


def _write_cache(packing: Packing, packing_hash: str) -> None:
    """Put a packing into the cache atomically; a cache that cannot be written only costs time later."""
    path = cache_folder() / _cached_name(packing_hash)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as temporary:
            temporary.write_bytes(packing_to_bytes(packing, packing_hash))
    except (OSError, OutputRefusedError) as error:
        cure = f"set {CACHE_VARIABLE} to a folder that works"
        why = error.strerror if isinstance(error, OSError) else f"{path.name} is not a file of a packing"
        tell(f"Packing: not kept in the cache {path.parent} ({why}); {cure}.")
