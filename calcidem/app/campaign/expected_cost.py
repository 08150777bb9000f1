"""Time, memory and disk that a campaign will need on this machine, estimated before the run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import thread_time

import numpy as np

from calcidem.app.config.checks import cutoff_estimate, disks_in_box, limit_of_mean_disks
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.first_look import WAVELENGTHS, expected_speed
from calcidem.sweep.batch import Batch, Cell

_RECORDED_PART = 1.25  # of the pulse and one and a half travel times: when readings are settled
# Stability limit of a cemented sample over that of mean disks: 1.18 to 1.20 from 0.66 to 9 % of `paper`.
_STEP_OVER_MEAN_DISKS = 1.19
_SECONDS_OF_CELL = 0.02  # reading, numerical error, graph
# For a disk and a sample, eight samples side by side.
_SECONDS_OF_DISK_STEP = {"linear": 5e-9, "small": 9e-9, "finite": 22e-9}
_SECONDS_WHERE_MEASURED = 2.7e-3  # of `_seconds_of_arithmetic`
_PACKING_SECONDS, _PACKING_DISKS = 15.0, 4700  # the time goes with the power 3/2 of their number
# Of memory: Python with NumPy and numba, and more for each disk, and each disk of each lane.
_BYTES_OF_PROCESS, _BYTES_OF_DISK, _BYTES_OF_DISK_AND_LANE = 210e6, 1e3, 800.0
# Of a database; the NetCDF file has as many.
_BYTES_OF_CAMPAIGN, _BYTES_OF_CELL, _BYTES_OF_CELL_AND_DISK = 150e3, 18e3, 2.0
_MOST_SOLVED = 20_000  # whose stiffness is found in a second or two
_PACKINGS_OVER_LATTICE = 0.5  # velocity of packings over that of the hexagonal lattice, without cement


@dataclass(frozen=True, slots=True)
class ExpectedCost:
    """Cost of cells, each number good to a factor of two."""

    seconds: float
    """On one core of this machine, the kernels compiled and the packing made."""
    packing_seconds: float
    """To make the packing."""
    memory: float
    """Bytes of each process that computes."""
    disk: float
    """Bytes of the database and the NetCDF file."""


def expected_speeds(configuration: Configuration, packing: Packing | None) -> dict[float, float]:
    """Shear-wave velocity that is expected at each content of a plan, m/s.

    It is the static speed of one sample, or where there is no packing yet, or a large one, half of that of the
    hexagonal lattice, increased by the same amount for each percent of calcite: good to a factor of two with cement.
    """
    contents = configuration.campaign.contents
    lattice = np.pi * float(np.mean(configuration.packing.diameter)) * cutoff_estimate(configuration, cemented=False)
    rough = {content: _PACKINGS_OVER_LATTICE * float(lattice) * (1.0 + content) for content in contents}
    if packing is None or len(packing.radius) > _MOST_SOLVED:
        return rough
    experiment = configuration.experiment(packing)
    found = {}
    for content in contents:
        try:
            found[content] = expected_speed(experiment, content, patterns=1)
        except ValueError:  # it carries no shear
            found[content] = rough[content]
    return found


def expected_cost(
    configuration: Configuration, speeds: Mapping[float, float], batches: Sequence[Batch[Cell]]
) -> ExpectedCost:
    """Cost of the batches of a configuration whose waves have these speeds, m/s, at each content."""
    wave, lanes, table = configuration.wave, configuration.run.lanes, configuration.excitation.table
    disks, path = disks_in_box(configuration), configuration.packing.width
    seconds, cells = 0.0, 0
    for batch in batches:
        content = batch.cells[0][1]
        travel = path / speeds[content]
        period = travel / WAVELENGTHS if table is None else 1.0 / table.at(content)
        longer = _STEP_OVER_MEAN_DISKS if content > 0.0 else 1.0
        step = wave.step_fraction * longer * limit_of_mean_disks(configuration, cemented=content > 0.0)
        steps = _RECORDED_PART * (period + 1.5 * travel) / step
        seconds += lanes * steps * disks * _SECONDS_OF_DISK_STEP[wave.regime] + _SECONDS_OF_CELL * len(batch.cells)
        cells += len(batch.cells)
    slower = _seconds_of_arithmetic() / _SECONDS_WHERE_MEASURED
    return ExpectedCost(
        seconds=slower * seconds,
        packing_seconds=slower * _PACKING_SECONDS * (disks / _PACKING_DISKS) ** 1.5,
        memory=_BYTES_OF_PROCESS + disks * (_BYTES_OF_DISK + lanes * _BYTES_OF_DISK_AND_LANE),
        disk=2.0 * (_BYTES_OF_CAMPAIGN + cells * (_BYTES_OF_CELL + disks * _BYTES_OF_CELL_AND_DISK)),
    )


def _seconds_of_arithmetic() -> float:
    """CPU time of some arithmetic of NumPy on this machine, s: the least of several, since other programs may run."""
    values, least = np.linspace(1.0, 2.0, 4096), np.inf
    for _ in range(5):
        began = thread_time()
        for _ in range(300):
            np.sqrt(values * values + values)
        least = min(least, thread_time() - began)
    return float(least)
