"""What the choice of the regime costs as the pulse gets stronger.

A pulse of another amplitude asks another physical question, so every amplitude has the finite regime as its own truth,
at the same step and the same samples: what is left is the regime's error and nothing else.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calcidem.app.studies.accuracy.reference import fitting_lanes, relative_deviation
from calcidem.app.studies.accuracy.settings import with_wave
from calcidem.dem.engine.scene import Regime
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, measure_all

_AMPLITUDES = (1.0e-5, 1.0e-4, 1.0e-3, 1.0e-2, 1.0e-1)  # m/s
_DENSE_SAMPLES = 400  # in a period of the pulse

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
    own, _ = _measure_regime(experiment, "finite", experiment.wave.amplitude, contents, seeds, lanes)
    rows = []
    for amplitude in amplitudes:
        progress(f"regimes at {amplitude:g} m/s")
        finite, refusal = _measure_regime(experiment, "finite", amplitude, contents, seeds, lanes)
        rows.append(_row_of(amplitude, "finite", finite, own, refusal))
        for regime in regimes:
            found, refusal = _measure_regime(experiment, regime, amplitude, contents, seeds, lanes)
            rows.append(_row_of(amplitude, regime, found, finite, refusal))
    return tuple(rows)


def _measure_regime(
    experiment: Experiment,
    regime: Regime,
    amplitude: float,
    contents: Sequence[float],
    seeds: Sequence[int],
    lanes: int,
) -> tuple[_CellsFound, str]:
    """Cells of a regime at an amplitude, and why some were refused."""
    setting = with_wave(experiment, regime=regime, amplitude=amplitude, samples_per_period=_DENSE_SAMPLES)
    found: _CellsFound = {}
    refusal = ""
    for content in contents:
        try:
            cells = measure_all(setting, content, seeds, lanes=fitting_lanes(seeds, lanes))
        except ValueError as refused:
            refusal = str(refused)
            continue
        found |= {(cell.seed, content): cell for cell in cells}
    return found, refusal


def _row_of(amplitude: float, regime: Regime, found: _CellsFound, exact: _CellsFound, refusal: str) -> AmplitudeRow:
    """Errors of the cells that are in both."""
    pairs = [(found[key], exact[key]) for key in found.keys() & exact.keys()]
    errors = [abs(error) for cell, other in pairs if (error := relative_deviation(cell.vs, other.vs)) is not None]
    readable = sum(cell.vs is not None for cell in exact.values())
    return AmplitudeRow(
        amplitude=amplitude,
        regime=regime,
        cells=len(errors),
        lost=readable - len(errors),
        median=float(np.median(errors)) if errors else None,
        worst=max(errors, default=None),
        refusal=refusal,
    )
