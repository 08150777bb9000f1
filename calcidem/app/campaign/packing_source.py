"""Where the packing of a campaign comes from: its database, the cache, or the computation."""

import os
import tempfile
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path

import numpy as np

from calcidem.app.campaign.own_disks import packing_of_own_disks
from calcidem.app.campaign.packing_archive import DamagedPackingError, from_bytes, to_bytes
from calcidem.app.campaign.packing_record import stored_packing
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.packing import Packing, make_packing
from calcidem.storage.store import Store

CACHE_VARIABLE = "CALCIDEM_CACHE"
"""Names the folder of the cache, if it is not to be ``$XDG_CACHE_HOME/calcidem``."""

Tell = Callable[[str], None]


class PackingPurpose(IntEnum):
    """Streams of random numbers of a packing; 1 and 2 of the same root belong to the cement."""

    DISKS = 0

    def generator(self, root_seed: int, seed: int) -> np.random.Generator:
        """Generator of this stream, the same wherever it is asked for."""
        sequence = np.random.SeedSequence(root_seed, spawn_key=(seed, self.value))
        return np.random.Generator(np.random.PCG64(sequence))


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
    packing = cached(path, tell)
    if packing is not None:
        tell(f"Packing: taken from the cache, {path}.")
        return packing
    draw = configuration.packing_draw
    if draw.file is not None:
        tell(f"Packing: the disks in {draw.file} are brought to rest; this is done once.")
        packing = packing_of_own_disks(configuration, check)
    else:
        tell("Packing: being made; this is done once and takes about half a minute for 4,700 disks.")
        generator = PackingPurpose.DISKS.generator(configuration.campaign.root_seed, draw.seed)
        packing = make_packing(configuration.packing, configuration.sand, generator, check)
    keep(path, packing, tell)
    return packing


def cached(path: Path, tell: Tell) -> Packing | None:
    """Packing in a file of the cache; None if there is none that is whole."""
    try:
        return from_bytes(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, DamagedPackingError) as error:
        tell(f"Packing: the cached {path} is damaged ({error}); it is made anew.")
        return None


def keep(path: Path, packing: Packing, tell: Tell) -> None:
    """Put a packing into the cache in one step; a cache that cannot be written costs time later, nothing else."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        temporary = Path(name)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(to_bytes(packing))
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        cure = f"set {CACHE_VARIABLE} to a folder that works"
        tell(f"Packing: not kept in the cache {path.parent} ({error.strerror}); {cure}.")
