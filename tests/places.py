"""Files that several tests use: those of the checkout, and those that are made once."""

from collections.abc import Callable
from pathlib import Path

CHECKOUT = Path(__file__).parents[1]

TUTORIAL = CHECKOUT / "docs" / "tutorial" / "quick.db"
"""Database of 8 seeds x 5 contents on the published sand, really computed and complete."""

SMALL_PACKING = CHECKOUT / "tests" / "assets" / "small_packing.npz"
"""280 disks in a box of 30 mm x 60 mm under 5 kPa: the packing of `small_configuration`, of which it states the key.

It is a file because packing is chaotic: no test may hang on what one draw gives on one processor."""

MakeOnce = Callable[[str, Callable[[Path], object]], Path]
"""Takes the name of a folder and what fills it; gives the folder."""
