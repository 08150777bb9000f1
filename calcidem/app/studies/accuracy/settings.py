"""Compared numerical settings; each differs from the experiment's own in one knob.

Two knobs, amplitude and equilibrium, have separate tables, because they have another reference.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.rule import WHOLE_DOMAIN
from calcidem.dem.wave.scene import domain_of

DEFAULT = "default"
UNDAMPED = "damping 0"
REFERENCE_SAMPLES = 1600  # samples per period of the pulse


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
    adds: str = ""
    """What this setting computes and the experiment leaves out; empty if nothing."""
    why: str = ""
    """Reason why the experiment may leave it out."""


def with_wave(experiment: Experiment, **changes: Any) -> Experiment:  # noqa: ANN401 - fields of several types
    """Return the experiment with changed fields of its `WaveRule`."""
    return replace(experiment, wave=replace(experiment.wave, **changes))


def settings(experiment: Experiment, contents: Sequence[float]) -> Iterator[Setting]:
    """Yield the settings of a study: the experiment's own first, then every knob; contents in percent."""
    wave = experiment.wave
    yield Setting(DEFAULT, experiment)
    yield from _vary(experiment, "step_fraction", (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.95))
    yield from _vary(experiment, "samples_per_period", (50, 100, 200, 400))  # the stride of the record
    for other in _vary(experiment, "precision", ("float32", "float64")):
        double = wave.precision == "float32"
        why = "each cell's error bound includes the rounding"
        yield replace(other, adds="double precision", why=why) if double else other
    if experiment.installation == "preserve":
        yield from _regimes(experiment, contents)
    everywhere = Setting("whole domain", with_wave(experiment, keep=(*wave.keep, WHOLE_DOMAIN)))
    share = 1.0 - len(domain_of(experiment.packing, wave, experiment.installation).packing.x) / len(
        experiment.packing.x
    )
    why = f"no signal reaches {share:.0%} of the disks, deep in the damping layers or without contacts"
    yield replace(everywhere, adds="disks out of reach", why=why) if share > 0.0 else everywhere
    stop = experiment.early_stop
    other = Setting(f"early_stop {not stop}", replace(experiment, early_stop=not stop))
    yield replace(other, adds="steps after the pick", why="the reading uses no later data") if stop else other
    # Combinations, in which errors of several knobs add up or cancel.
    yield Setting("single precision, step 0.95", with_wave(experiment, precision="float32", step_fraction=0.95))
    finer = with_wave(experiment, regime="finite", step_fraction=0.4, samples_per_period=400)
    yield Setting("finite, 400 samples, step 0.4", finer)
    if wave.damping > 0.0:
        yield Setting(UNDAMPED, with_wave(experiment, damping=0.0), numerical=False)
    for name in ("transmitter_half_width", "receiver_half_width"):
        for factor in (0.8, 1.25):
            width = factor * getattr(wave, name)
            yield Setting(f"{name} {1e3 * width:g} mm", with_wave(experiment, **{name: width}), numerical=False)


def _regimes(experiment: Experiment, contents: Sequence[float]) -> Iterator[Setting]:
    """Yield the other regimes, and the contact search."""
    wave, own = experiment.wave, experiment.wave.regime
    stroke = Pulse(wave.amplitude, min(map(experiment.frequency, contents))).stroke
    why = f"the pulse moves the transmitter by {stroke / experiment.packing.report.mean_overlap:.1g} mean overlaps"
    adds = {} if own == "finite" else {"finite": "new normals and overlaps"}
    if own == "linear":
        adds["small"] = "slip, opening and Hertz stiffening"
    for other in _vary(experiment, "regime", ("linear", "small", "finite")):
        regime = other.experiment.wave.regime
        yield replace(other, adds=adds[regime], why=why) if regime in adds else other
    if own != "finite":
        searching = with_wave(experiment, regime="finite", keep=(*wave.keep, "search"))
        yield Setting("contact search", searching, adds="new contacts", why=why)


def _vary(experiment: Experiment, knob: str, values: Iterable[Any]) -> Iterator[Setting]:
    """Yield the experiment with each other value of one field of its `WaveRule`."""
    for value in values:
        if value != getattr(experiment.wave, knob):
            yield Setting(f"{knob} {value}", with_wave(experiment, **{knob: value}))
