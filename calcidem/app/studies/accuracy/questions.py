"""Questions with a truth of their own: strength of the pulse, balance of the packing, scatter of the samples.

A pulse of another amplitude asks another physical question, so every amplitude has the finite regime as its own truth,
at the same step and samples. A packing is compared with the same one, left to come to rest longer. The numerical error
of a mean stands beside its statistical one.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calcidem.analysis.distribution import describe
from calcidem.app.studies.accuracy.reference import CellError, measure_cells, relative_deviation
from calcidem.app.studies.accuracy.settings import DEFAULT, with_wave
from calcidem.dem.engine.assembly import pair_keys
from calcidem.dem.engine.scene import Preload, Regime
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement

SCATTER_SEEDS = 16  # seeds that tell the scatter if no stored campaign does
_AMPLITUDES = (1.0e-5, 1.0e-4, 1.0e-3, 1.0e-2, 1.0e-1)  # m/s
_DENSE_SAMPLES = 400  # in a period of the pulse
_RATIOS = (1.0e-4, 1.0e-5, 1.0e-6, 1.0e-7)  # unbalanced-force ratios; the smallest is taken for exact

_CellsFound = dict[tuple[int, float], Measurement]


@dataclass(frozen=True, slots=True)
class AmplitudeRow:
    """One regime at one amplitude, over all cells.

    Attributes
    ----------
    amplitude
        v0 of the pulse, m/s.
    regime
        Of the cells.
    cells
        With a velocity here and in the finite regime.
    lost
        With a velocity in the finite regime only: refused, or no velocity because the stated error is above 5 %.
    median, worst
        Relative error of Vs against the finite regime of this amplitude; for the finite regime itself, against its
        velocity at the experiment's own amplitude: no error, but what the strength of the pulse does to the sample.
    refusal
        Why there are no cells, if it was refused beforehand.
    """

    amplitude: float
    regime: Regime
    cells: int
    lost: int
    median: float | None
    worst: float | None
    refusal: str = ""


@dataclass(frozen=True, slots=True)
class EquilibriumRow:
    """Packing with one unbalanced-force ratio, over all cells.

    Attributes
    ----------
    unbalanced_force_ratio
        That ratio.
    changed_contacts
        Contacts that touch here or in the packing with the smallest ratio, but not in both.
    cells
        Compared.
    median, worst
        Relative error of Vs against the packing with the smallest ratio, all else equal.
    """

    unbalanced_force_ratio: float
    changed_contacts: int
    cells: int
    median: float
    worst: float


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
    numerical, worst
        Median and largest of the numerical errors of the default setting.
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


def _errors(found: _CellsFound, exact: _CellsFound) -> list[float]:
    """Absolute relative errors of Vs of the cells that have a velocity in both."""
    deviations = (relative_deviation(found[key].vs, exact[key].vs) for key in exact if key in found)
    return [abs(error) for error in deviations if error is not None]


def amplitude_rows(
    experiment: Experiment,
    contents: Sequence[float],
    seeds: Sequence[int],
    amplitudes: Sequence[float] = _AMPLITUDES,
    *,
    regimes: Sequence[Regime] = ("linear", "small"),
    lanes: int = 8,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[AmplitudeRow, ...]:
    """Measure some regimes at several amplitudes against the finite one."""

    def measured(regime: Regime, amplitude: float) -> tuple[_CellsFound, str]:
        setting = with_wave(experiment, regime=regime, amplitude=amplitude, samples_per_period=_DENSE_SAMPLES)
        found: _CellsFound = {}
        refusal = ""
        for content in contents:
            try:
                found |= measure_cells(setting, content, seeds, lanes)
            except ValueError as refused:
                refusal = str(refused)
        return found, refusal

    own, _ = measured("finite", experiment.wave.amplitude)
    rows = []
    for amplitude in amplitudes:
        progress(f"regimes at {amplitude:g} m/s")
        finite, refusal = measured("finite", amplitude)
        compared: list[tuple[Regime, _CellsFound, _CellsFound, str]] = [("finite", finite, own, refusal)]
        for regime in regimes:
            found, refusal = measured(regime, amplitude)
            compared.append((regime, found, finite, refusal))
        for regime, found, exact, refusal in compared:
            errors = _errors(found, exact)
            lost = sum(cell.vs is not None for cell in exact.values()) - len(errors)
            median = float(np.median(errors)) if errors else None
            rows.append(AmplitudeRow(amplitude, regime, len(errors), lost, median, max(errors, default=None), refusal))
    return tuple(rows)


def equilibrium_rows(
    experiment: Experiment,
    contents: Sequence[float],
    seeds: Sequence[int],
    packing_of: Callable[[float], Packing],
    ratios: Sequence[float] = _RATIOS,
    *,
    lanes: int = 8,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[EquilibriumRow, ...]:
    """Measure Vs in packings of several unbalanced-force ratios, with the cement at the same contacts.

    ``packing_of`` makes the experiment's packing for a ratio.
    """
    packings = {}
    for ratio in ratios:
        progress(f"packing with an unbalanced-force ratio of {ratio:g}")
        packings[ratio] = packing_of(ratio)
    best = packings[min(ratios)]
    found: dict[float, _CellsFound] = {}
    for ratio, packing in packings.items():
        setting = replace(experiment, packing=_same_contacts(packing, best))
        found[ratio] = {}
        for content in contents:
            found[ratio] |= measure_cells(setting, content, seeds, lanes)
    rows = []
    for ratio, packing in packings.items():
        errors = _errors(found[ratio], found[min(ratios)])
        changed = set(_keys_of(packing)) ^ set(_keys_of(best))
        rows.append(
            EquilibriumRow(ratio, len(changed), len(errors), float(np.median(errors)), max(errors, default=np.inf))
        )
    return tuple(rows)


def _same_contacts(packing: Packing, model: Packing) -> Packing:
    """Packing with the list of contacts of another one, so that cement is drawn at the same places.

    Which contacts touch is a matter of the positions; the list says where cement may go and which carry shear.
    """
    known = dict(zip(_keys_of(packing), np.asarray(packing.preload.shear).tolist(), strict=True))
    shear = np.array([known.get(key, 0.0) for key in _keys_of(model)])
    return replace(packing, preload=Preload(model.pairs, shear))


def _keys_of(packing: Packing) -> list[int]:
    """One number for each contact."""
    keys: list[int] = pair_keys(packing.pairs, len(packing.radius)).tolist()
    return keys


def scatter_rows(
    cells: Iterable[CellError], velocities: Mapping[float, Sequence[float]], seeds: int
) -> tuple[Scatter, ...]:
    """Put the errors of a study's default setting beside the scatter of the samples.

    ``velocities`` has samples of Vs at each content, m/s; ``seeds`` are those of the campaign whose mean is asked for.
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
        sizes = np.abs(found)
        rows.append(
            Scatter(
                content=content,
                samples=len(samples),
                deviation=deviation,
                seeds=seeds,
                statistical=deviation / float(np.sqrt(seeds)),
                numerical=float(np.median(sizes)),
                worst=float(np.max(sizes)),
                bias=float(np.mean(found)),
            )
        )
    return tuple(rows)
