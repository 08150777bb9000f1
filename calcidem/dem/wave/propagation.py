"""Propagation of a shear wave: preparation of a batch of samples, and one pulse through all of them.

The transmitter moves along its wall, and the wave crosses the box to the receiver. The samples of a batch differ only
in their cement and are computed side by side.

Signals are recorded until they suffice or a guard ends them. The guards check each chunk of the record for causes of
unreliable results. In an unstable explicit scheme velocities grow by a constant factor per step. 1 % above the limit
they double in three steps, so an instability between two checks exceeds every bound at the second. What suits no sample
is refused before the first step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calcidem.dem.engine.assembly import lanes_of_bits
from calcidem.dem.engine.fields import require
from calcidem.dem.engine.leapfrog import Kernel, State, run_in_place
from calcidem.dem.engine.portable import length
from calcidem.dem.engine.readout import look_undamped, net_forces, overlaps, wall_overlaps
from calcidem.dem.engine.scene import Bonds, Scene
from calcidem.dem.engine.stability import critical_time_step, stiffest_contacts
from calcidem.dem.engine.state import choose_features, start
from calcidem.dem.kernels.gpu import gpu_card
from calcidem.dem.kernels.layout import XY, Features, Flags, Floats, Integers, Recording, X, Y
from calcidem.dem.sample.cement import CementOrdering
from calcidem.dem.sample.compaction import settle
from calcidem.dem.wave.experiment import (
    FEWEST_SAMPLES,
    TRANSMITTER,
    Experiment,
    driven_disks,
    lane_bonds,
    listening_disks,
    station_disks,
    wave_scene,
)
from calcidem.dem.wave.reading import is_settled, record_duration
from calcidem.dem.wave.section import Counts, Pulse, Section, quantise

SAMPLES_PER_CHUNK = 20  # samples between two checks of the section: half a period of the pulse


@dataclass(slots=True)
class Recorder:
    """Batch of samples crossed by a pulse, advanced chunk by chunk."""

    state: State
    """Newly started state; each sample has a lane."""
    pulse: Pulse
    """Motion of the transmitter."""
    stride: int
    """Time steps between two samples of the signals."""
    listeners: tuple[Integers, ...]
    places: tuple[float, ...]
    """Disks with recorded mean velocities, in memory order, for each station and last for the receiver, and their
    paths, see `Section.places`.
    """
    driven_disks: Integers
    """Disks with prescribed motion, in memory order."""
    samples: int
    """Number of samples; further lanes are ignored."""
    longest: float
    """Time after which a record ends in any case, s."""
    unbalanced_speed: Floats
    """(L,) see `Section`."""
    signs: Floats
    """(L,) sense of the pulse: 1, or -1 for a reversed one. Sections are positive as the pulse."""
    breakable: float = 0.0
    """See `problems_of`."""
    kernel: Kernel | None = None
    """Advances the samples on a GPU; None for the processor."""
    counts: Counts = field(init=False)
    """(L, 2, X, S) motion across and along so far, see `Section`."""
    broken: Integers = field(init=False)
    """(L,) number of broken bonds."""

    def __post_init__(self) -> None:
        """Initialize the results."""
        self.counts = np.zeros((self.state.features.lanes, 2, len(self.listeners), 0), dtype=np.int32)
        self.broken = broken_bonds(self.state)

    def run(self, stop_when: Callable[[Section], bool], raise_if_stopped: Callable[[], None]) -> list[Section]:
        """Sections of all samples, in their order; see `send_waves`."""
        overlap = float(np.mean(np.maximum(overlaps(self.state), 0.0)))
        ended: dict[int, Section] = {}
        while len(ended) < self.samples:
            raise_if_stopped()
            self.record_chunk()
            running = [lane for lane in range(self.samples) if lane not in ended]
            problems = problems_of(self.state, self.pulse.amplitude, overlap, self.breakable)
            remaining = self._remaining_speeds()
            for lane in running:
                section = self.section_of(lane, problems[lane], float(remaining[lane]))
                if section.problem or section.duration >= self.longest or stop_when(section):
                    ended[lane] = section
        return [ended[lane] for lane in sorted(ended)]

    def record_chunk(self, samples: int = SAMPLES_PER_CHUNK) -> None:
        """Advance by a number of samples."""
        steps = samples * self.stride
        dtype, lanes = self.state.motion.velocity.dtype, self.state.features.lanes
        groups = self.listeners * 2
        middle = (self.state.steps + np.arange(steps)[:, None] + 0.5) * self.state.time_step
        recording = Recording(
            drive=(self.signs * self._sent_at(middle)).astype(dtype),
            driven=-1 if len(self.driven_disks) else TRANSMITTER,
            driven_disks=self.driven_disks,
            offset=0,
            stride=self.stride,
            listeners=np.concatenate(groups),
            groups=np.cumsum([0, *map(len, groups)]),
            axes=np.repeat([Y, X], len(self.listeners)),
            samples=np.zeros((samples, len(groups), lanes), dtype),
        )
        self.state = run_in_place(self.state, steps, recording, self.kernel)
        self.broken = broken_bonds(self.state)
        recorded = recording.samples.astype(float).transpose(2, 1, 0)
        recorded *= self.signs[:, None, None]
        chunk = quantise(recorded, self.pulse.amplitude).reshape(lanes, 2, len(self.listeners), samples)
        self.counts = np.concatenate([self.counts, chunk], axis=3)

    def _sent_at(self, times: Floats) -> Floats:
        """Velocities of the transmitter at given times, m/s; computed in one call once it is at rest."""
        first = times.min()
        resting = self.pulse.frequency * first >= 1.0  # same condition as in `Pulse.velocity`
        return np.full(times.shape, self.pulse.velocity(first)) if resting else self.pulse.velocity(times)

    def _remaining_speeds(self) -> Floats:
        """(L,) see `Section.remaining_speed`, m/s.

        Half of the energy of waves is kinetic, on the path and at the receiver, and damping only reduces it. The mean
        velocity of n disks is largest if they move together; its square is at most ``sum(m v^2) / (n m)``.
        """
        mass = self.state.scene.mass[self.state.assembly.order]
        velocity = self.state.motion.velocity[:, XY].astype(float)
        moving = (mass[:, None, None] * (velocity * velocity)).sum(axis=0).sum(axis=0)
        fewest = min(len(disks) * float(mass[disks].min()) for disks in self.listeners)
        return np.asarray(np.sqrt(moving / fewest))

    def section_of(self, lane: int, problem: str = "", remaining_speed: float = np.inf) -> Section:
        """Section of a lane so far, with its problem, if any."""
        step = float(self.state.time_step[lane])
        across, along = (np.ascontiguousarray(motion.T) for motion in self.counts[lane])
        return Section(
            sampling_interval=self.stride * step,
            # A sample is taken at the end of every stride-th step; leapfrog velocities are those at its middle.
            start_time=(self.stride - 0.5) * step,
            frequency=self.pulse.frequency,
            amplitude=self.pulse.amplitude,
            places=self.places,
            across=across,
            along=along,
            time_step=step,
            stability_limit=float(self.state.critical_time_step[lane]),
            steps=self.state.steps,
            unbalanced_speed=float(self.unbalanced_speed[lane]),
            broken_bonds=int(self.broken[lane]),
            remaining_speed=remaining_speed,
            problem=problem,
        )


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
    bare = [not np.any(flags) for flags in bonded]
    if len(set(bare)) == 2:
        # Samples without cement are recorded more coarsely, here as in a batch of their own.
        found: dict[int, Section] = {}
        for kind in (False, True):
            places = [place for place, own in enumerate(bare) if own is kind]
            sections = send_waves(
                experiment,
                [bonded[place] for place in places],
                frequency,
                stop_when=stop_when,
                lanes=lanes,
                raise_if_stopped=raise_if_stopped,
                signs=[signs[place] for place in places] if signs else (),
            )
            found |= dict(zip(places, sections, strict=True))
        return [found[place] for place in range(len(bonded))]
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
    """Prepare a batch for transmission with common sampling; the arguments are those of `send_waves`."""
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
        kernel=gpu_card().GpuSteps() if experiment.gpu else None,
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
    """Kernel features that the wave needs; samples without cement use the kernel of the others."""
    rule, finite = experiment.wave, experiment.wave.contact_law == "finite"
    return replace(
        choose_features(scene, rule.contact_law, lanes),
        recording=True,
        driven=rule.transmitter == "driven",
        servo=False,
        midpoint=False,
        bonds=True,
        linear_group=experiment.cement.linear_modulus > 0.0,
        breakage=finite,
    )


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
    steps: int | None = None,
    watch: Callable[[int, int], None] = lambda _done, _all: None,
) -> _WaveFilm:
    """Transmit a pulse through one sample, and record its disks at equal intervals.

    Parameters
    ----------
    experiment, bonded, frequency
        As for `send_waves`; one sample's contacts.
    frames
        Largest number of frames.
    steps
        Time steps, such as those of a stored cell; by default the longest of a measurement.
    watch
        Called with the number of finished and of all frames; may raise to end the run.
    """
    recorder = prepare_recorder(experiment, [bonded], frequency, 8, lambda: None)  # lanes, as a campaign has compiled
    interval = recorder.stride * float(recorder.state.time_step[0])
    samples = (steps or 0) // recorder.stride or int(np.ceil(recorder.longest / interval))
    stride = -(-samples // frames)
    times, velocity = [], []
    for begin in range(0, samples, stride):
        recorder.record_chunk(min(stride, samples - begin))
        times.append(float(recorder.state.time[0]))
        velocity.append(recorder.state.velocity()[:, 1].astype(np.float32))
        watch(len(times), -(-samples // stride))
    scene = recorder.state.scene
    return _WaveFilm(scene.x, scene.y, scene.radius, np.array(times), np.array(velocity), recorder.section_of(0))


def problems_of(state: State, amplitude: float, overlap: float, breakable: float = 0.0) -> list[str]:
    """Problem of each lane; empty for lanes without one.

    Parameters
    ----------
    state
        State to check; all lanes together cost about as much as one.
    amplitude
        Amplitude of the pulse, m/s; nothing moves much faster in a sample that was at rest.
    overlap
        Mean overlap of the contacts at the start, m.
    breakable
        Largest permitted share of broken bonds.
    """
    problems = [""] * state.features.lanes
    # Comparisons with NaN are false, so the valid case is tested.
    # Waves stay below about five times the amplitude.
    for lane in np.flatnonzero(~(_largest_translation(state.motion.velocity) <= 30.0 * amplitude)).tolist():
        speed = np.abs(state.motion.velocity[:, :2, lane]).max(axis=1)
        # The place identifies the disk, since the computed disks are renumbered.
        disk = int(state.assembly.order[int(np.argmax(speed))])
        place = f"({state.scene.x[disk]:.5g}, {state.scene.y[disk]:.5g}) m"
        problems[lane] = f"the disk at {place} moves at {speed.max():.3g} m/s after {state.steps} steps"
    if state.features.linear:
        return problems
    broken = broken_bonds(state)
    if broken.any():
        bonds = np.count_nonzero(lanes_of_bits(state.assembly.pairs.cemented, state.features.lanes), axis=0)
        for lane in np.flatnonzero(broken > breakable * bonds).tolist():
            problem = f"{broken[lane]} bonds broke within {state.steps} steps: the pulse changes the sample; "
            problems[lane] = problems[lane] or problem + "lower amplitude"
    # Below a tenth of the mean overlap stiffness changes stay within the margin of the step.
    motion = _largest_translation(state.motion.displacement)
    noticed = (motion > 0.1 * overlap) & (state.time_step > cheap_limit(state))
    if not noticed.any():
        return problems
    # Hertz contacts stiffen under load.
    limit = critical_time_step(state.scene, state.assembly, state.features, overlaps(state), wall_overlaps(state))
    for lane in np.flatnonzero(noticed & (state.time_step > limit)).tolist():
        problems[lane] = problems[lane] or (
            f"the step of {state.time_step[lane]:.3g} s is above the stability limit of the pressed contacts "
            f"after {state.steps} steps, {limit[lane]:.3g} s: lower step_fraction or amplitude"
        )
    return problems


def broken_bonds(state: State) -> Integers:
    """(L,) number of broken bonds; zero if the kernel breaks none."""
    pairs, lanes = state.assembly.pairs, state.features.lanes
    if not state.features.breakage or not (pairs.cemented ^ pairs.intact).any():
        return np.zeros(lanes, dtype=np.int64)
    return np.asarray(np.count_nonzero(lanes_of_bits(pairs.cemented ^ pairs.intact, lanes), axis=0))


def _largest_translation(field: Floats) -> Floats:
    """(L,) largest absolute value of the translations in each lane; NaN if one of them is NaN."""
    # All components including rotation are reduced at once: a long contiguous row is much faster.
    translations: Floats = np.abs(field).max(axis=0)[:2]
    both: Floats = translations.max(axis=0)
    return both


def unbalanced_speed(state: State, amplitude: float) -> Floats:
    """(L,) rms speed of the disks by unbalanced forces alone, over the amplitude of the pulse.

    A disk with the net force F oscillates with about ``F / (m omega)``. Omega follows from the limit ``2 / omega`` of
    the Hertz contacts; bonds are far stiffer, but do not affect disks without a bond. The linear law assumes a
    balanced reference state. `ValueError` if the speed exceeds 0.001.
    """
    lanes = state.features.lanes
    if state.features.linear:
        return np.zeros(lanes)
    # Without bonds all lanes have the same limit.
    pressed = replace(state.features, lanes=1, bonds=False, breakage=False, linear_group=False)
    swing = float(critical_time_step(state.scene, state.assembly, pressed)[0]) / 2.0
    speed, ahead = np.empty(lanes), look_undamped(state)
    for lane in range(lanes):
        force = length(*net_forces(state, lane, ahead)[:, :2].T)
        speed[lane] = float(np.sqrt(np.mean((force / state.scene.mass) ** 2))) * swing
    preserved = state.scene.bonds is None or state.scene.bonds.installation == "preserve"
    # Cement that changes the forces settles after it is installed.
    what, cure = ("packing alone", 'law = "linear", or a packing with') if preserved else ("settled sample", "or")
    require(
        bool(np.all(speed <= 1e-3 * amplitude)),
        "amplitude",
        amplitude,
        f"unbalanced forces of the {what} move its disks at {speed.max():.3g} m/s, more than "
        f"0.001 of the pulse: choose a stronger pulse, {cure} a smaller unbalanced_force_ratio",
    )
    return speed / amplitude


def cheap_limit(state: State) -> Floats:
    """Lower bound (L,) of the present stability limit, s, at a tenth of its cost.

    To the initial matrices of `stability.critical_time_step` each Hertz contact adds at most its own largest
    eigenvalue, ``max(k_n, 3 k_s)``. If stiff bonds limit the step, this is negligible at any load.
    """
    share = 2.0 * max(1.0, 3.0 * state.scene.sand.shear_ratio)
    added = share * stiffest_contacts(state.assembly, overlaps(state), wall_overlaps(state))
    at_start = 2.0 / state.critical_time_step
    return np.asarray(2.0 / np.sqrt(at_start * at_start + added))
