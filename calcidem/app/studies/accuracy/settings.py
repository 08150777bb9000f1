"""Compared numerical settings; each differs from the experiment's own in one knob.

Two knobs, amplitude and equilibrium, have separate tables, because they have another reference.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from calcidem.dem.wave.check import cheapest_law
from calcidem.dem.wave.experiment import Experiment, domain_of
from calcidem.dem.wave.rule import WHOLE_DOMAIN, Pulse

DEFAULT = "default"
UNDAMPED = "damping 0"
REFERENCE_SAMPLES = 1600  # samples per period of the pulse
_CHECKED = "check samples of each content have it, and the stated error includes it"


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


def unchecked(experiment: Experiment) -> Experiment:
    """The experiment without checks, with the contact law that they try first."""
    return replace(experiment, is_checked=False).with_wave(law=cheapest_law(experiment))


def settings(experiment: Experiment, contents: Sequence[float]) -> Iterator[Setting]:
    """Yield the settings of a study: the experiment's own first, then every knob; contents in percent.

    The first has its checks, which may choose another law and step at each content. The others have none.
    """
    yield Setting(DEFAULT, experiment)
    experiment = unchecked(experiment)
    wave = experiment.wave
    yield from _vary(experiment, "step_fraction", (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.95))
    yield from _vary(experiment, "samples_per_period", (50, 100, 200, 400))  # the stride of the record
    for other in _vary(experiment, "precision", ("float32", "float64")):
        double = wave.precision == "float32"
        yield replace(other, adds="double precision", why=_CHECKED) if double else other
    if experiment.installation == "preserve":
        yield Setting("law linear", experiment.with_wave(law="linear"))
    finite = Setting("law finite", experiment.with_wave(law="finite"))
    stroke = Pulse(wave.amplitude, min(map(experiment.frequency, contents))).stroke
    share = stroke / experiment.packing.report.mean_overlap
    why = f"{_CHECKED}; the pulse moves the transmitter by {share:.1g} mean overlaps"
    yield replace(finite, adds="slip, opening, new contacts", why=why) if wave.law == "linear" else finite
    everywhere = Setting("whole domain", experiment.with_wave(keep=(*wave.keep, WHOLE_DOMAIN)))
    share = 1.0 - len(domain_of(experiment.packing, wave, experiment.installation).packing.x) / len(
        experiment.packing.x
    )
    why = f"no signal reaches {share:.0%} of the disks, deep in the damping layers or without contacts"
    yield replace(everywhere, adds="disks out of reach", why=why) if share > 0.0 else everywhere
    # Combinations, in which errors of several knobs add up or cancel.
    yield Setting("single precision, step 0.95", experiment.with_wave(precision="float32", step_fraction=0.95))
    finer = experiment.with_wave(law="finite", step_fraction=0.4, samples_per_period=400)
    yield Setting("finite, 400 samples, step 0.4", finer)
    if wave.damping > 0.0:
        yield Setting(UNDAMPED, experiment.with_wave(damping=0.0), numerical=False)
    for name in ("transmitter_half_width", "receiver_half_width"):
        for factor in (0.8, 1.25):
            width = factor * getattr(wave, name)
            yield Setting(f"{name} {1e3 * width:g} mm", experiment.with_wave(**{name: width}), numerical=False)


def _vary(experiment: Experiment, knob: str, values: Iterable[Any]) -> Iterator[Setting]:
    """Yield the experiment with each other value of one field of its `WaveRule`."""
    for value in values:
        if value != getattr(experiment.wave, knob):
            yield Setting(f"{knob} {value}", experiment.with_wave(**{knob: value}))
