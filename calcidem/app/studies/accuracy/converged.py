"""The converged reference: its step is halved until that changes no velocity any more."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calcidem.app.studies.accuracy.batches import fitting_lanes, timed
from calcidem.app.studies.accuracy.comparison import relative
from calcidem.app.studies.accuracy.settings import reference
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement

HALVING = 1.0e-4  # relative change of Vs by which halving the step may move it
COARSEST = 0.4  # step over the limit that is tried first
FINEST = 0.05  # and that is not gone below


@dataclass(frozen=True, slots=True)
class ReferenceCell:
    """Reference of one cell.

    Attributes
    ----------
    seed, content
        The cell; content in percent.
    vs
        m/s; None where the reference has no trusted pick either.
    step_fraction
        Its step over the stability limit.
    halving
        Relative change of Vs when a step twice as large was halved to that step; None without a velocity.
    """

    seed: int
    content: float
    vs: float | None
    step_fraction: float
    halving: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Reference of all cells of a content: measurements, what is said of them, and processor time of a cell, s."""

    measurements: tuple[Measurement, ...]
    cells: tuple[ReferenceCell, ...]
    seconds: float


def converged(
    experiment: Experiment, content: float, seeds: Sequence[int], lanes: int, coarsest: float = COARSEST
) -> Reference:
    """Measure a content exactly: the step of each cell is halved until its Vs changes by less than `HALVING`.

    A cell that is still moving at `FINEST` stays with that, and says by how much.
    """
    step, waiting = coarsest, list(seeds)
    before, _ = by_seed(experiment, step, content, waiting, lanes)
    done: dict[int, tuple[Measurement, ReferenceCell, float]] = {}
    while waiting:
        step /= 2.0
        now, seconds = by_seed(experiment, step, content, waiting, lanes)
        for seed in waiting:
            change = relative(now[seed].vs, before[seed].vs)
            if change is None or abs(change) < HALVING or step <= FINEST:
                done[seed] = now[seed], ReferenceCell(seed, content, now[seed].vs, step, change), seconds
        waiting = [seed for seed in waiting if seed not in done]
        before = now
    rows = [done[seed] for seed in seeds]
    return Reference(tuple(row[0] for row in rows), tuple(row[1] for row in rows), float(np.mean([r[2] for r in rows])))


def by_seed(
    experiment: Experiment, step: float, content: float, seeds: Sequence[int], lanes: int
) -> tuple[dict[int, Measurement], float]:
    """Measurements with a step, and processor time of a cell, s."""
    found, seconds = timed(reference(experiment, step), content, seeds, fitting_lanes(seeds, lanes))
    return {cell.seed: cell for cell in found}, seconds
