"""A campaign on the user's own disks: the key ``file`` of section ``[packing]``."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from calcidem.app.config.errors import Problem, shown
from calcidem.app.config.schema import SETTLED_BY_FILE, Configuration
from calcidem.dem.sample.packing import Packing
from calcidem.dem.sample.packing_file import PackingFileError, checked_disks, packing_from_csv

CONCERNED = ("packing.file", *(f"packing.{key}" for key in SETTLED_BY_FILE))
"""Fields that nothing else can be compared with when the file is not as it should be."""


def take_own_disks(parts: dict[str, Any], given: Mapping[str, Any], folder: Path) -> list[Problem]:
    """Look at the file of ``[packing]``, if there is one, and put what it settles into the parts.

    Parameters
    ----------
    parts
        Of the configuration: ``packing`` and ``packing_draw`` are replaced.
    given
        The section as it was given.
    folder
        To which the file's name is relative.

    Returns
    -------
    list of Problem
        What is wrong with the file or contradicts it.
    """
    rule, draw = parts["packing"], parts["packing_draw"]
    if draw.file is None:
        return []
    problems = [
        Problem(
            f"packing.{key} = {shown(given[key])}: the disks in packing.file settle it; leave one of the two out",
            (f"packing.{key}", "packing.file"),
        )
        for key in SETTLED_BY_FILE
        if key in given
    ]
    path = (folder / Path(draw.file).expanduser()).absolute()
    try:
        _, y, radius = checked_disks(path, rule.width)
        smallest, largest = (2.0 * float(value) for value in (radius.min(), radius.max()))
        parts["packing"] = replace(rule, height=float(np.max(y + radius)), diameter=(smallest, largest))
        parts["packing_draw"] = replace(draw, file=str(path), file_sha256=sha256(path.read_bytes()).hexdigest())
    except (PackingFileError, OSError, ValueError) as error:
        problems.append(Problem(f"packing.file = {shown(draw.file)}: {error}", CONCERNED))
    return problems


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
