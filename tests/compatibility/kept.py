"""A database and a NetCDF file of version 1.0, compressed in ``assets``, and what they hold.

    python tests/compatibility/kept.py

computes them anew: only before 1.0 is published, after a change of what a cell's bits are, or of its columns.
"""

import json
import lzma
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from calcidem.app.campaign.opened import Campaign, open_campaign
from calcidem.app.campaign.packing import _cached_name
from calcidem.app.campaign.run import run
from calcidem.app.config.reader import read_configuration
from calcidem.storage.netcdf import export_netcdf

ASSETS = Path(__file__).parent / "assets"
SMALL_PACKING = Path(__file__).parents[1] / "assets" / "small_packing.npz"
SETTINGS = {
    "campaign": {"name": "kept", "seeds": 2, "contents": [5.0]},
    "packing": {"width": 0.03, "height": 0.06, "unbalanced_force_ratio": 1e-5},
    "sand": {"wave_stiffness_factor": 4.7},
    "wave": {"receiver_half_width": 0.01, "listening_depth": 0.006, "boundary_thickness": 0.01, "frequency": 15e3},
    "pick": {"largest_error": 1.0},
    "run": {"lanes": 2},
}


def open_kept(ending: str, folder: Path) -> Path:
    """Unpack the file with an ending into a folder."""
    path = folder / f"calcidem_1.0.{ending}"
    path.write_bytes(lzma.decompress((ASSETS / f"{path.name}.xz").read_bytes()))
    return path


def contents_of(campaign: Campaign) -> dict[str, Any]:
    """What a later version has to find: identity, outcomes, velocities, and the sizes of arrays."""
    cells = list(campaign.select(with_arrays=True))
    return {
        "hash": campaign.record.hash,
        "packing": campaign.content_hash(),
        "disks": len(campaign.packing().x),
        "attempts": len(list(campaign.store.history())),
        "cells": [[cell.key.seed, cell.key.content, cell.status, cell.vs, cell.steps, cell.host] for cell in cells],
        "samples of a section": [None if c.section is None else list(c.section.across.shape) for c in cells],
        "cemented contacts": [None if c.cement is None else len(c.cement.contacts) for c in cells],
    }


def expected() -> dict[str, Any]:
    """What was in them when they were made."""
    found: dict[str, Any] = json.loads((ASSETS / "contents.json").read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Compute the campaign and write all three files."""
    configuration = read_configuration(SETTINGS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["CALCIDEM_CACHE"] = name
        shutil.copy(SMALL_PACKING, folder / _cached_name(configuration.packing_hash))
        run(configuration, db=folder / "calcidem_1.0.db").close()
        with open_campaign(folder / "calcidem_1.0.db") as campaign:
            export_netcdf(campaign.store, folder / "calcidem_1.0.nc")
            text = json.dumps(contents_of(campaign), indent=1)
        (ASSETS / "contents.json").write_text(text + "\n", encoding="utf-8")
        for ending in ("db", "nc"):
            packed = lzma.compress((folder / f"calcidem_1.0.{ending}").read_bytes(), preset=9)
            (ASSETS / f"calcidem_1.0.{ending}.xz").write_bytes(packed)


if __name__ == "__main__":
    main()
