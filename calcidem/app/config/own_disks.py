"""A campaign on the user's own disks: the key ``file`` of section ``[packing]``, and what it settles."""

from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from calcidem.app.config.errors import Problem, quote
from calcidem.app.config.schema import SETTLED_BY_FILE, Configuration
from calcidem.dem.sample.packing_file import checked_disks

_CONCERNED = ("packing.file", *(f"packing.{key}" for key in SETTLED_BY_FILE))
"""Fields that nothing else can be compared with when the file is not as it should be."""


def take_own_disks(
    configuration: Configuration, given: Mapping[str, Any], folder: Path
) -> tuple[Configuration, list[Problem]]:
    """Look at the file of ``[packing]``, and put what it settles into the configuration.

    ``given`` is the section as it was given; the file's name is relative to ``folder``. Given are the configuration
    with the size of the box and of the disks, where the file is as it should be, and what is wrong with the file or
    contradicts it.
    """
    problems = [
        Problem(
            f"packing.{key} = {quote(given[key])}: the disks in packing.file settle it; leave one of the two out",
            (f"packing.{key}", "packing.file"),
        )
        for key in SETTLED_BY_FILE
        if key in given
    ]
    rule, draw = configuration.packing, configuration.packing_draw
    try:
        path = (folder / Path(str(draw.file)).expanduser()).absolute()
        _, y, radius = checked_disks(path, rule.width)
        smallest, largest = (2.0 * float(value) for value in (radius.min(), radius.max()))
        rule = replace(rule, height=float(np.max(y + radius)), diameter=(smallest, largest))
        draw = replace(draw, file=str(path), file_sha256=sha256(path.read_bytes()).hexdigest())
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError also where ~ has no folder
        problems.append(Problem(f"packing.file = {quote(draw.file)}: {error}", _CONCERNED))
    return replace(configuration, packing=rule, packing_draw=draw), problems
