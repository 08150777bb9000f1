"""Put the packings of the example configurations into the package, so that everybody computes on the same disks.

    python scripts/preset_packings.py

Files that are there stay, those that no example needs go. A packing that the shipped campaign was computed on is taken
from its file, others are made. To be run when `PHYSICS_VERSION` or an example's packing changes; after that the shipped
campaign and the tutorial's database have to be computed anew.
"""

import os
import tempfile
from pathlib import Path

from calcidem.app.campaign.packing import (
    CACHE_VARIABLE,
    packing_from_bytes,
    packing_to_bytes,
    provide_packing,
    stored_packing,
)
from calcidem.app.cli.run import Preset
from calcidem.app.config import presets
from calcidem.app.config.reader import load_configuration
from calcidem.storage.netcdf import import_netcdf
from calcidem.storage.sql.store import Store

PRESETS = Path(presets.__file__).parent
PACKINGS = PRESETS / "packings"


def main() -> None:
    """Write what is missing."""
    PACKINGS.mkdir(exist_ok=True)
    configurations = [load_configuration(PRESETS / f"{preset}.toml") for preset in Preset]
    files = {PACKINGS / f"{found.packing_hash[:32]}.npz": found for found in configurations}
    for file in set(PACKINGS.iterdir()) - files.keys():
        file.unlink()
    with tempfile.TemporaryDirectory() as folder:
        os.environ[CACHE_VARIABLE] = folder  # nothing that other code made
        with Store(Path(folder) / "paper.db") as store:
            import_netcdf(PRESETS / "paper.nc", store)
            shipped = store.packing()
        for file, configuration in files.items():
            if file.exists():
                continue
            is_shipped = shipped is not None and shipped.hash == configuration.packing_hash
            packing = stored_packing(shipped) if is_shipped else provide_packing(configuration, None)
            file.write_bytes(packing_to_bytes(packing, configuration.packing_hash))
    for file, configuration in files.items():
        packing = packing_from_bytes(file.read_bytes(), configuration.packing_hash)
        print(f"{file.name}: {len(packing.radius)} disks, content hash {packing.content_hash}")


if __name__ == "__main__":
    main()
