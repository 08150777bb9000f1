"""Keep velocities and features of all variants and packings of the pages, from which tests compute their tables.

    python docs/reproduction/variants.py sensitivity.db beyond.db p27182.db p31415.db

The first two databases are those of `calcidem sensitivity` with sensitivity.toml and beyond.toml, the others those of
the preset `paper` with 24 seeds and other packings.
"""

import sys
from pathlib import Path

import xarray as xr

from calcidem.analysis.packing_graph import FEATURES, NETWORK_FEATURES
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.studies.sensitivity import read_variants

FOLDER = Path(__file__).parent
NAMES = ("vs", "effective_vs", *FEATURES, *NETWORK_FEATURES)


def main() -> None:
    """Write variants.nc, (variant, seed, content); a variant of both plans is that of the second."""
    *plans, one, other = sys.argv[1:]
    found = {}
    for plan, database in zip(("sensitivity", "beyond"), plans, strict=True):
        for variant in read_variants(FOLDER / f"{plan}.toml", database):
            found[variant.name] = kept(database, variant.name)
    for database in (one, other):
        found[Path(database).stem] = kept(database, None)
    joined = xr.concat(found.values(), xr.Variable("variant", [*found]), join="outer", combine_attrs="drop")
    packed = {"zlib": True, "complevel": 9, "dtype": "float32"}
    joined.to_netcdf(FOLDER / "variants.nc", encoding=dict.fromkeys(NAMES, packed))


def kept(database: str, name: str | None) -> xr.Dataset:
    """Velocities and features of a campaign, without units."""
    with open_campaign(database, name) as campaign:
        return campaign.to_xarray(NAMES)[[*NAMES]].drop_attrs()


if __name__ == "__main__":
    main()
