"""Local stiffness of the samples of a campaign, with what a random-field model takes in of it."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

import numpy as np
import xarray as xr

from calcidem.analysis.random_field import field_statistics
from calcidem.dem.kernels.layout import Flags
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.stiffness_field import StiffnessField, stiffness_field
from calcidem.storage.errors import UnknownCellError


class Cemented(Protocol):
    """Gives the experiment of a cell, and which of its packing's pairs (C,) are cemented."""

    def __call__(self, *, seed: int, content: float) -> tuple[Experiment, Flags]:
        """Raise `UnknownCellError` where that is not known."""


def stiffness_of_cells(
    cemented: Cemented,
    seed: int | Sequence[int],
    content: float | Sequence[float],
    window: float,
    watch: Callable[[int, int], None],
) -> xr.Dataset:
    """Local stiffness of cells; see `calcidem.app.campaign.opened.Campaign.stiffness`.

    Raises
    ------
    UnknownCellError
        If none of the cells is known.
    """
    seeds, contents = np.unique(np.asarray(seed)), np.unique(np.asarray(content, dtype=float))
    cells = [(int(one), float(other)) for other in contents for one in seeds]
    found: dict[tuple[int, float], StiffnessField] = {}
    for number, cell in enumerate(cells, 1):
        with suppress(UnknownCellError):
            found[cell] = stiffness_field(*cemented(seed=cell[0], content=cell[1]), window)
        watch(number, len(cells))
    if not found:
        raise UnknownCellError("None of these cells has an outcome.", "'calcidem status DB' shows which have.")
    x, y, first = next(iter(found.values()))
    moduli = np.array([found[cell].modulus if cell in found else np.full_like(first, np.nan) for cell in cells])
    fields = xr.DataArray(
        moduli.reshape(len(contents), len(seeds), *first.shape),
        {"content": contents, "seed": seeds, "y": y, "x": x},
        ("content", "seed", "y", "x"),
        attrs={"units": "Pa", "long_name": "local shear modulus"},
    )
    described = field_statistics(fields).assign(shear_modulus=fields)
    described["content"].attrs["units"] = "percent"
    for axis in ("x", "y"):
        described[axis].attrs["units"] = "m"
        described[f"scale_{axis}"].attrs.update(units="m", long_name=f"scale of fluctuation of ln G along {axis}")
    described["geometric_mean"].attrs["units"] = "Pa"
    return described
