"""Packing of a campaign: taken from storage (`calcidem.app.campaign.stored_packing`), or made."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

from calcidem.app.campaign.notices import tell
from calcidem.app.campaign.stored_packing import (
    CACHE_VARIABLE,
    DamagedPackingError,
    cache_folder,
    packing_from_bytes,
    packing_to_bytes,
    stored_packing,
)
from calcidem.app.config.presets import preset_packings
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.cement import RandomPurpose, random_generator
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.packing import PACKING_METHOD, Packing, PackingFileError, PackingStage
from calcidem.dem.sample.packing_file import packing_from_csv
from calcidem.input_file import MOST_BYTES, InputFileError, read_input
from calcidem.storage.errors import OutputRefusedError
from calcidem.storage.files import write_atomically
from calcidem.storage.sql.store import Store


def provide_packing(
    configuration: Configuration,
    store: Store | None,
    check: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """Packing of a campaign: from its database, from calcidem itself, or from the cache; made only if none has it.

    While a packing is made, ``check`` is called every fraction of a second and may raise to end it, and ``watch``
    receives the progress. `PackingError` if it has to be made and does not come to rest, `DamagedStoreError` if the
    stored one is damaged or belongs to another configuration.
    """
    if store is not None and 0 in store.packing_indices():
        return stored_packing(store.packing(), configuration.packing_hash)
    kept = kept_packing(configuration.packing_hash)
    packing = kept or new_packing(configuration, check, watch)
    if kept is None:
        _write_cache(packing, configuration.packing_hash)
    return packing


def new_packing(
    configuration: Configuration,
    check: Callable[[], None] = lambda: None,
    watch: Callable[[PackingStage], None] = lambda _: None,
) -> Packing:
    """New packing of a configuration, without search in storage; see `provide_packing`."""
    draw = configuration.packing_draw
    if draw.file is not None:
        tell(f"Packing: the disks in {draw.file} are brought to rest; this is done once.")
        disks = Path(draw.file)
        if sha256(read_input(disks, MOST_BYTES)).hexdigest() != draw.file_sha256:
            raise PackingFileError(f"{disks} was changed while the campaign began; run the command again")
        return packing_from_csv(disks, configuration.sand, configuration.packing, check, watch)
    tell("Packing: being made; this is done once.")
    generator = random_generator(configuration.campaign.root_seed, draw.seed, RandomPurpose.DISKS)
    return make_packing(configuration.packing, configuration.sand, generator, check, watch)


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
