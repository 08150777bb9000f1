"""Frozen records of a campaign and its packings."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from hashlib import sha256
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from calcidem.storage.errors import CampaignMismatchError
from calcidem.storage.records.canonical import config_difference
from calcidem.storage.records.cell import canonical_content, checked_seed
from calcidem.storage.records.quantity import Along, Bound, Quantity, Record
from calcidem.storage.records.run import as_utc

_packing = partial(Quantity, origin="packing", bound=Bound.NOT_NEGATIVE)


@dataclass(frozen=True, slots=True, eq=False)
class PackingRecord(Record):
    """A packing with the report on its quality; the annotations explain its numbers."""

    index: Annotated[int, Quantity("1", "index of the packing")]
    """0 to k - 1 when a campaign has k packings."""
    hash: Annotated[str, Quantity("", "hash of what it was made from")]
    """Packings with the same hash may differ between versions."""
    x: Annotated[NDArray[np.float64], Along("grain", "m", "horizontal position of the centre")]
    y: Annotated[NDArray[np.float64], Along("grain", "m", "vertical position of the centre")]
    radius: Annotated[NDArray[np.float64], Along("grain", "m", "radius")]
    """Centres and radii of the disks [m]. Shape (grains,)."""
    width: Annotated[float, _packing("m", "width of the box", bound=Bound.POSITIVE)]
    height: Annotated[float, _packing("m", "height of the lid", bound=Bound.POSITIVE)]
    porosity: Annotated[float, _packing("1", "area of the voids over area of the box")]
    coordination_number: Annotated[float, _packing("1", "mean number of contacts of a grain")]
    coordination_number_without_rattlers: Annotated[
        float, _packing("1", "mean number of contacts of a grain that carries load")
    ]
    """2 N_contacts / N with and without rattlers."""
    wall_stress: Mapping[str, float]
    """Normal stress on each wall [Pa], by name of the wall."""
    mean_relative_overlap: Annotated[float, _packing("1", "mean overlap over mean diameter")]
    largest_relative_overlap: Annotated[float, _packing("1", "largest overlap over mean diameter")]
    unbalanced_ratio: Annotated[float, _packing("1", "mean unbalanced force over mean contact force")]
    seconds: Annotated[float, _packing("s", "computing time")]
    state: Annotated[bytes, Along("state_byte", "1", "complete state, a NumPy .npz file")]
    """Restores the packing bit for bit; its format is not interpreted here."""
    content_hash: Annotated[str, Quantity("", "hash of its own bits: disks, walls and forces")]
    """Identity of the packing itself."""

    def __post_init__(self) -> None:
        Record.__post_init__(self)
        if self.index < 0:
            raise ValueError(f"PackingRecord.index is {self.index}; packings count from 0.")
        if not (len(self.radius) and (self.radius > 0.0).all()):
            raise ValueError("PackingRecord.radius must hold positive radii of at least one grain.")
        for wall, stress in self.wall_stress.items():
            if not math.isfinite(stress):
                raise ValueError(f"PackingRecord.wall_stress[{wall!r}] is {stress}; give a finite stress in Pa.")

    def refuse_other(
        self, other: "PackingRecord", places: tuple[str, str] = ("the database", "what is to be stored")
    ) -> None:
        """Raise `CampaignMismatchError` unless two records are of the same packing; the message names both places."""
        same = ("index", "hash", "content_hash", "width", "height", "x", "y", "radius")  # a record may have been edited
        if all(np.array_equal(getattr(self, name), getattr(other, name)) for name in same):
            return
        origins = "" if self.hash == other.hash else f" (they are made from {self.hash} and {other.hash})"
        raise CampaignMismatchError(
            f"Packing {self.index} has the content hash {self.content_hash} in {places[0]} and {other.content_hash} in "
            f"{places[1]}{origins}.",
            "Cells of two packings can't be in one campaign: keep them in databases of their own. 'calcidem run' on a "
            "database uses its packing; new databases with a common folder CALCIDEM_CACHE get the same packing.",
        )


@dataclass(frozen=True, slots=True)
class CampaignRecord:
    """Configuration and plan of a campaign."""

    hash: str
    """Identity of the physics."""
    name: str
    """Unique name within the store."""
    config: str
    """The whole physical configuration as canonical JSON text (`calcidem.storage.records.canonical.canonical_json`)."""
    contents: tuple[float, ...]
    """Planned contents [%], ascending."""
    seeds: tuple[int, ...]
    """Planned seeds, ascending."""
    created: datetime
    """Time with time zone; kept as UTC."""

    def __post_init__(self) -> None:
        for field in ("hash", "name"):
            if not getattr(self, field):
                raise ValueError(f"CampaignRecord.{field} is empty; give a text.")
        object.__setattr__(self, "contents", tuple(sorted({canonical_content(c) for c in self.contents})))
        object.__setattr__(self, "seeds", tuple(sorted({checked_seed(s) for s in self.seeds})))
        object.__setattr__(self, "created", as_utc(self.created))

    @property
    def parameters(self) -> dict[str, Any]:
        """Configuration, by section and key."""
        found: dict[str, Any] = json.loads(self.config)
        return found

    @property
    def checksum(self) -> str:
        """SHA-256 of hash and configuration together, 64 hexadecimal digits."""
        return sha256(f"{self.hash}\n{self.config}".encode()).hexdigest()

    def refuse_other(self, given: "CampaignRecord") -> None:
        """Raise `CampaignMismatchError`, which lists the differences, unless `given` is of the same campaign.

        With equal hashes each may have keys that the other lacks, since keys at their defaults are not hashed. Values
        of common keys must be equal. This detects a default that was changed without a new version of the physics.
        """
        is_same_hash = self.hash == given.hash
        differences = config_difference(self.config, given.config, shared_only=is_same_hash)
        if is_same_hash and not differences:
            return
        lines = "\n  ".join(differences or ["(none in the configurations' text)"])
        raise CampaignMismatchError(
            f"The stored campaign '{self.name}' with the hash {self.hash} has another configuration than "
            f"'{given.name}' with the hash {given.hash} (stored -> given):\n  {lines}\n",
            "Give the old values to continue it, or a new database or campaign name for the new ones; seeds and "
            "contents may differ.",
        )
