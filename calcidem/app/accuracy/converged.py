"""The converged reference: its step is halved until that changes no velocity any more."""

from collections.abc import Sequence
from dataclasses import dataclass

from calcidem.app.accuracy.batches import timed
from calcidem.app.accuracy.comparison import relative
from calcidem.app.accuracy.settings import reference
from calcidem.dem.measurement import Experiment, Measurement

HALVING = 1.0e-4  # relative change of Vs by which halving the step may move it
COARSEST = 0.4  # step over the limit that is tried first
FINEST = 0.025  # and that is not gone below


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
    """Measure a content exactly: the step is halved until Vs changes by less than `HALVING` in every cell."""
    step = coarsest
    before, _ = timed(reference(experiment, step), content, seeds, lanes)
    while True:
        step /= 2.0
        now, seconds = timed(reference(experiment, step), content, seeds, lanes)
        changes = [relative(fine.vs, coarse.vs) for fine, coarse in zip(now, before, strict=True)]
        if step <= FINEST or max((abs(change) for change in changes if change is not None), default=0.0) < HALVING:
            break
        before = now
    cells = (
        ReferenceCell(cell.seed, content, cell.vs, step, change) for cell, change in zip(now, changes, strict=True)
    )
    return Reference(now, tuple(cells), seconds)
