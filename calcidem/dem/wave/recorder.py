"""Recording of a wave: signals of each sample of a batch, until they suffice or a guard ends them.

The guards check each chunk of the record for causes of unreliable results. In an unstable explicit scheme velocities
grow by a constant factor per step. 1 % above the limit they double in three steps, so an instability between two checks
exceeds every bound at the second.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from calcidem.dem.engine.assembly import lanes_of_bits
from calcidem.dem.engine.fields import require
from calcidem.dem.engine.leapfrog import Kernel, State, run_in_place
from calcidem.dem.engine.portable import length
from calcidem.dem.engine.readout import look_undamped, net_forces, overlaps, wall_overlaps
from calcidem.dem.engine.stability import critical_time_step, hertz_tangent
from calcidem.dem.kernels.layout import LISTENED, XY, Floats, Integers, Recording, X, Y
from calcidem.dem.wave.experiment import RECEIVER, TRANSMITTER
from calcidem.dem.wave.reading import Pulse
from calcidem.dem.wave.section import Counts, Section, quantise


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
    require(
        bool(np.all(speed <= 1e-3 * amplitude)),
        "amplitude",
        amplitude,
        f"unbalanced forces of the packing alone move its disks at {speed.max():.3g} m/s, more than "
        '0.001 of the pulse: choose a stronger pulse, law = "linear", or a packing with a '
        "smaller unbalanced_force_ratio",
    )
    return speed / amplitude


def cheap_limit(state: State) -> Floats:
    """Lower bound (L,) of the present stability limit, s, at a tenth of its cost.

    To the initial matrices of `stability.critical_time_step` each Hertz contact adds at most its own largest
    eigenvalue, ``max(k_n, 3 k_s)``. If stiff bonds limit the step, this is negligible at any load.
    """
    pairs, wall_pairs, grains = state.assembly.pairs, state.assembly.wall_pairs, state.assembly.grains
    normal = np.zeros((len(grains.radius), state.features.lanes))
    pressed, leaning = (
        hertz_tangent(pairs.hertz, overlaps(state)),
        hertz_tangent(wall_pairs.hertz, wall_overlaps(state)),
    )
    for disk, stiffness in ((pairs.first, pressed), (pairs.second, pressed), (wall_pairs.disk, leaning)):
        np.add.at(normal, disk, stiffness)
    share = 2.0 * max(1.0, 3.0 * state.scene.sand.shear_ratio) * grains.inverse_mass * (1.0 + grains.damping)
    added = (share.astype(float)[:, None] * normal).max(axis=0)
    at_start = 2.0 / state.critical_time_step
    return np.asarray(2.0 / np.sqrt(at_start * at_start + added))


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
        """Sections of all samples, in their order; see `propagation.send_waves`."""
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
            receiver=RECEIVER,
            listeners=np.concatenate(groups),
            groups=np.cumsum([0, *map(len, groups)]),
            axes=np.repeat([Y, X], len(self.listeners)),
            samples=np.zeros((samples, 1 + len(groups), lanes), dtype),
        )
        self.state = run_in_place(self.state, steps, recording, self.kernel)
        self.broken = broken_bonds(self.state)
        recorded = recording.samples[:, LISTENED:].astype(float).transpose(2, 1, 0)
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
