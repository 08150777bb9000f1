"""Compared numerical settings; each differs from the experiment's own in one knob.

Two knobs, `amplitudes` and `equilibrium`, have separate tables, because they have another reference.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.rule import WHOLE_DOMAIN

DEFAULT = "default"
UNDAMPED = "damping 0"
_STEP_FRACTIONS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.95)
_SAMPLES_PER_PERIOD = (50, 100, 200, 400)  # samples per period of the pulse: the stride of the record
_BANDS = (0.8, 1.25)  # half-widths over the experiment's own
REFERENCE_SAMPLES = 1600


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting for computing the same cells."""

    name: str
    """Changed parameter and its value, unique in a study."""
    experiment: Experiment
    """Complete experiment."""
    numerical: bool = True
    """False if the exact answer also changes, as with the width of a band or the damping. The difference is then not an
    error, and `Study.cheapest` excludes the setting.
    """


def with_wave(experiment: Experiment, **changes: Any) -> Experiment:  # noqa: ANN401 - fields of several types
    """Return the experiment with changed fields of its `WaveRule`."""
    return replace(experiment, wave=replace(experiment.wave, **changes))


def settings(experiment: Experiment) -> Iterator[Setting]:
    """Yield the settings of a study: the experiment's own first, then every knob."""
    wave = experiment.wave
    yield Setting(DEFAULT, experiment)
    yield from _vary(experiment, "step_fraction", _STEP_FRACTIONS)
    yield from _vary(experiment, "samples_per_period", _SAMPLES_PER_PERIOD)
    yield from _vary(experiment, "precision", ("float32", "float64"))
    if experiment.installation == "preserve":
        yield from _vary(experiment, "regime", ("linear", "small", "finite"))
    yield Setting("whole domain", with_wave(experiment, keep=(*wave.keep, WHOLE_DOMAIN)))
    yield Setting(f"early_stop {not experiment.early_stop}", replace(experiment, early_stop=not experiment.early_stop))
    # Combinations, in which errors of several knobs add up or cancel.
    yield Setting("single precision, step 0.95", with_wave(experiment, precision="float32", step_fraction=0.95))
    finer = with_wave(experiment, regime="finite", step_fraction=0.4, samples_per_period=400)
    yield Setting("finite, 400 samples, step 0.4", finer)
    if wave.damping > 0.0:
        yield Setting(UNDAMPED, with_wave(experiment, damping=0.0), numerical=False)
    for name in ("transmitter_half_width", "receiver_half_width"):
        for factor in _BANDS:
            width = factor * getattr(wave, name)
            yield Setting(f"{name} {1e3 * width:g} mm", with_wave(experiment, **{name: width}), numerical=False)


def _vary(experiment: Experiment, knob: str, values: Iterable[Any]) -> Iterator[Setting]:
    """Yield the experiment with each other value of one field of its `WaveRule`."""
    for value in values:
        if value != getattr(experiment.wave, knob):
            yield Setting(f"{knob} {value}", with_wave(experiment, **{knob: value}))
