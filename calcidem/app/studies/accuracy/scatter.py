"""Statistical error of the mean beside the numerical error, content by content."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calcidem.analysis.distribution import describe
from calcidem.app.studies.accuracy.reference import CellError, fitting_lanes
from calcidem.app.studies.accuracy.settings import DEFAULT
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure_all

SCATTER_SEEDS = 16  # seeds that tell the scatter if no stored campaign does


@dataclass(frozen=True, slots=True)
class Scatter:
    """One content.

    Attributes
    ----------
    content
        Percent.
    samples
        That the scatter is known from.
    deviation
        Standard deviation of Vs over its mean.
    seeds
        Of the campaign.
    statistical
        Relative standard error of the campaign's mean, ``deviation / sqrt(seeds)``.
    numerical
        Median of the numerical errors of the default setting, and
    worst
        the largest of them.
    bias
        Their mean with sign: what the campaign's mean is off by. Unlike the statistical error it does not fall with the
        number of seeds.
    """

    content: float
    samples: int
    deviation: float
    seeds: int
    statistical: float
    numerical: float
    worst: float
    bias: float


def quick_campaign(
    experiment: Experiment, contents: Sequence[float], seeds: Sequence[int], lanes: int = 8
) -> dict[float, list[float]]:
    """Velocities of the experiment's own setting at each content, m/s."""
    width = fitting_lanes(seeds, lanes)
    return {
        content: [cell.vs for cell in measure_all(experiment, content, seeds, lanes=width) if cell.vs is not None]
        for content in contents
    }


def scatter_rows(
    cells: Iterable[CellError], velocities: Mapping[float, Sequence[float]], seeds: int
) -> tuple[Scatter, ...]:
    """Put the errors of the default setting beside the scatter of the samples.

    Parameters
    ----------
    cells
        Of a study.
    velocities
        Samples of Vs at each content, m/s.
    seeds
        Of the campaign whose mean is asked for.
    """
    errors: dict[float, list[float]] = {}
    for cell in cells:
        if cell.setting == DEFAULT and cell.vs_error is not None:
            errors.setdefault(cell.content, []).append(cell.vs_error)
    rows = []
    for content, found in sorted(errors.items()):
        samples = velocities.get(content, ())
        if len(samples) < 2:  # noqa: PLR2004 - a scatter needs two
            continue
        spread = describe(list(samples))
        deviation = spread.standard_deviation / spread.mean
        rows.append(
            Scatter(
                content=content,
                samples=len(samples),
                deviation=deviation,
                seeds=seeds,
                statistical=deviation / float(np.sqrt(seeds)),
                numerical=float(np.median(np.abs(found))),
                worst=float(np.max(np.abs(found))),
                bias=float(np.mean(found)),
            )
        )
    return tuple(rows)
