"""Propagation of a shear wave: preparation of a batch of samples, and one pulse through all of them.

The transmitter moves along its wall, and the wave crosses the box to the receiver. The samples of a batch differ only
in their cement and are computed side by side.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calcidem.dem.engine.fields import require
from calcidem.dem.engine.gpu import gpu_steps
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.readout import net_forces
from calcidem.dem.engine.scene import Bonds, Scene
from calcidem.dem.engine.state import choose_features, start
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import Flags, Floats
from calcidem.dem.sample.cement import CementOrdering
from calcidem.dem.sample.compaction import settle
from calcidem.dem.wave.experiment import (
    Experiment,
    driven_disks,
    lane_bonds,
    listening_disks,
    station_disks,
    wave_scene,
)
from calcidem.dem.wave.reading import FEWEST_SAMPLES, WHOLE_DOMAIN, Pulse, is_settled, record_duration
from calcidem.dem.wave.recorder import Recorder, unbalanced_speed
from calcidem.dem.wave.section import Section


def send_waves(
    experiment: Experiment,
    bonded: Sequence[Flags],
    frequency: float,
    *,
    stop_when: Callable[[Section], bool] | None = None,
    lanes: int = 8,
    raise_if_stopped: Callable[[], None] = lambda: None,
    signs: Sequence[float] = (),
) -> list[Section]:
    """Send one pulse through each of several samples, side by side.

    Parameters
    ----------
    experiment
        Common settings.
    bonded
        For each sample flags (C,), True for cemented pairs of the packing; at most ``lanes`` samples.
    frequency
        Frequency of the pulse, Hz.
    stop_when
        Called with each sample's section at fixed times; True ends it. By default it ends when it is settled.
    lanes
        Width of the kernel: 1, 2, 4, 8, 16 or 32. A sample's bits do not depend on how many of the lanes are in use.
    raise_if_stopped
        Called every fraction of a second; may raise to end the run.
    signs
        Sense of the pulse for each sample: 1, or -1 for a reversed one; by default 1.

    Returns
    -------
    One section for each sample. If a guard finds a problem, the sample is recomputed with half the step, and its
    section notes this. If that fails, too, the problem stays in the section.
    """
    is_over = stop_when or (lambda section: is_settled(section, experiment.clamp, section.remaining_speed))
    sections = prepare_recorder(experiment, bonded, frequency, lanes, raise_if_stopped, signs).run(
        is_over, raise_if_stopped
    )
    failed = [sample for sample, section in enumerate(sections) if section.problem]
    if failed:
        again = prepare_recorder(
            experiment.with_wave(step_fraction=0.5 * experiment.wave.step_fraction),
            [bonded[sample] for sample in failed],
            frequency,
            lanes,
            raise_if_stopped,
            [signs[sample] for sample in failed] if signs else (),
        )
        for sample, section in zip(failed, again.run(is_over, raise_if_stopped), strict=True):
            sections[sample] = replace(section, retry=sections[sample].problem)
    return sections


def prepare_recorder(
    experiment: Experiment,
    bonded: Sequence[Flags],
    frequency: float,
    lanes: int,
    raise_if_stopped: Callable[[], None],
    signs: Sequence[float] = (),
) -> Recorder:
    """Prepare a batch for transmission with a common step; the arguments are those of `send_waves`."""
    require(0 < len(bonded) <= lanes, "bonded", len(bonded), f"give 1 to {lanes} samples")
    rule, installation, pulse = experiment.wave, experiment.installation, Pulse(experiment.wave.amplitude, frequency)
    domain, bare = experiment.domain, experiment.bare_scene
    packing, driven = domain.packing, driven_disks(domain.packing, rule)
    bonds = lane_bonds(packing, experiment.cement, [flags[domain.pairs] for flags in bonded], lanes, installation)
    # Gap of listed pairs, in mean radii: no bit depends on it. If a disk moves further than ten strokes, pairs are
    # listed again; after a loud pulse with 0.2 so often that lists take a third as long as the kernel.
    skin = min(0.4, 2.0 * 10.0 * pulse.stroke / float(packing.radius.mean())) if rule.contact_law == "finite" else 0.0
    features = _wave_features(bare, experiment, lanes)
    single, scene = experiment.once(_bare_sample, features, skin)
    scene = replace(scene, bonds=bonds)
    state = _start_at_rest(experiment, scene, _wave_features(scene, experiment, lanes), skin, single)
    if bonds is not None and installation != "preserve":
        state = settle(state, rule.unbalanced_force_ratio, rule.most_settling_steps, raise_if_stopped)
    speed = unbalanced_speed(state, rule.amplitude)
    _refuse_short_pulse(float(state.time_step.max()), frequency)
    rank = np.argsort(state.assembly.order)
    # The same for all samples of a content.
    limit = experiment.once(_limit_of_all_patterns, bonds is not None)
    stride = max(1, int(1.0 / (frequency * rule.samples_per_period * rule.step_fraction * limit)))
    return Recorder(
        state,
        pulse,
        stride=stride,
        listeners=tuple(
            np.sort(rank[disks]) for disks in (*station_disks(packing, rule), listening_disks(packing, rule))
        ),
        places=experiment.places,
        driven_disks=np.sort(rank[driven]),
        samples=len(bonded),
        longest=record_duration(experiment.distance, rule.slowest, frequency),
        unbalanced_speed=speed,
        signs=np.array([*signs, *[1.0] * (lanes - len(signs))]),
        breakable=rule.most_broken_bonds,
        kernel=gpu_steps() if experiment.gpu else None,
    )


def _bare_sample(experiment: Experiment, features: Features, skin: float) -> tuple[State, Scene]:
    """Sample without cement in one lane, and its scene with the loads for these features."""
    scene = experiment.bare_scene
    bare = replace(features, lanes=1, bonds=False, linear_group=False, breakage=False)
    single = _start_at_rest(experiment, scene, bare, skin)
    if not features.linear and experiment.installation == "preserve":
        # Local damping would act on the packing's unbalanced forces as on the wave, so constant loads balance them.
        # All lanes share the loads, so they must not depend on cement or time step of a sample.
        # Zero loads are exact and save compiling a kernel without loads.
        unloaded = _start_at_rest(experiment, scene, replace(features, loads=True), skin, single)
        # With a power of two as the step, s, the forces are exact.
        scene = replace(scene, load=-net_forces(replace(unloaded, time_step=np.full(features.lanes, 2.0**-30))))
    return single, scene


def _start_at_rest(
    experiment: Experiment, scene: Scene, features: Features, skin: float, single: State | None = None
) -> State:
    """State of a scene before its pulse; see `state.start`."""
    return start(
        scene,
        features=features,
        precision=experiment.wave.precision,
        preload=experiment.domain.packing.preload,
        step_fraction=experiment.wave.step_fraction,
        skin_fraction=skin,
        steps_per_contact=0.0,
        single=single,
    )


def refuse_unfit_pulse(experiment: Experiment, frequency: float, *, cemented: bool) -> None:
    """Raise a `ValueError` if the pulse suits no sample of a packing, as far as known without cement."""
    _refuse_short_pulse(experiment.wave.step_fraction * experiment.once(_limit_of_all_patterns, cemented), frequency)


def refuse_unfit_samples(
    experiment: Experiment, content: float, orderings: Callable[[], Sequence[CementOrdering]], lanes: int
) -> None:
    """Raise a `ValueError` if the pulse does not suit one of several samples, as `send_waves` would.

    Samples are checked only if the pulse is short for the packing without cement, whose steps are longest. Settling
    after bonds that do not preserve the forces would take long. The packing without them replaces these samples, since
    its unbalanced forces are similar.

    Parameters
    ----------
    experiment
        Common settings.
    content
        Percent of the sand's mass.
    orderings
        Returns the cement of each sample, at most ``lanes``; called if it matters, since drawing it takes long.
    lanes
        Width of the kernel.
    """
    frequency = experiment.frequency(content)
    longest = experiment.wave.step_fraction * experiment.once(_limit_of_all_patterns, False)
    if experiment.installation != "preserve":
        bare = np.zeros(len(experiment.packing.pairs), dtype=bool)
        prepare_recorder(experiment, [bare], min(frequency, 0.5 / (longest * FEWEST_SAMPLES)), lanes, lambda: None)
    elif longest * frequency * FEWEST_SAMPLES > 1.0:
        bonded = [cement.at(content).bonded for cement in orderings()]
        prepare_recorder(experiment, bonded, frequency, lanes, lambda: None)


def _refuse_short_pulse(step: float, frequency: float) -> None:
    require(
        step * frequency * FEWEST_SAMPLES <= 1.0,
        "frequency",
        frequency,
        f"the pulse is shorter than {FEWEST_SAMPLES} time steps of {step:.3g} s, far above the sample's cut-off "
        f"frequency: choose a lower frequency, at most {int(1.0 / (step * FEWEST_SAMPLES))} Hz",
    )


def _limit_of_all_patterns(experiment: Experiment, cemented: bool) -> float:
    """Stability limit with every or no contact cemented, s; independent of pattern and batch."""
    rule, packing = experiment.wave, experiment.domain.packing
    bonds = Bonds(packing.pairs, experiment.cement, installation=experiment.installation) if cemented else None
    scene = wave_scene(packing, experiment.stiffen()[1], rule, bonds)
    features = choose_features(scene, rule.contact_law)
    state = start(scene, features=features, preload=packing.preload, steps_per_contact=0.0)
    return float(state.critical_time_step[0])


def _wave_features(scene: Scene, experiment: Experiment, lanes: int) -> Features:
    """Kernel features that the wave needs or the rule keeps; samples without cement use the kernel of the others."""
    rule, finite = experiment.wave, experiment.wave.contact_law == "finite"
    features = replace(
        choose_features(scene, rule.contact_law, lanes),
        recording=True,
        driven=rule.transmitter == "driven",
        servo=False,
        midpoint=False,
        bonds=True,
        linear_group=experiment.cement.linear_modulus > 0.0,
        breakage=finite,
    )
    return replace(features, **{name: True for name in rule.keep if name != WHOLE_DOMAIN})


@dataclass(frozen=True, slots=True, eq=False)
class _WaveFilm:
    """Motion of the computed disks in a wave."""

    x: Floats
    y: Floats
    radius: Floats
    """(N,) m, of the disks at rest."""
    times: Floats
    """(F,) s."""
    velocity: Floats
    """(F, N) along y, the direction of the transmitter's motion, m/s."""
    section: Section
    """Signals, identical to those of a measurement."""


def film_wave(
    experiment: Experiment,
    bonded: Flags,
    frequency: float,
    *,
    frames: int,
    samples: int | None = None,
    lanes: int = 8,
    watch: Callable[[int, int], None] = lambda _done, _all: None,
) -> _WaveFilm:
    """Transmit a pulse through one sample, and record its disks at equal intervals.

    Parameters
    ----------
    experiment, bonded, frequency, lanes
        As for `send_waves`; one sample's contacts.
    frames
        Largest number of frames.
    samples
        Length of the signals; by default the longest of a measurement.
    watch
        Called with the number of finished and of all frames; may raise to end the run.
    """
    recorder = prepare_recorder(experiment, [bonded], frequency, lanes, lambda: None)
    interval = recorder.stride * float(recorder.state.time_step[0])
    samples = samples or int(np.ceil(recorder.longest / interval))
    stride = -(-samples // frames)
    times, velocity = [], []
    for begin in range(0, samples, stride):
        recorder.record_chunk(min(stride, samples - begin))
        times.append(float(recorder.state.time[0]))
        velocity.append(recorder.state.velocity()[:, 1].astype(np.float32))
        watch(len(times), -(-samples // stride))
    scene = recorder.state.scene
    return _WaveFilm(scene.x, scene.y, scene.radius, np.array(times), np.array(velocity), recorder.section_of(0))
