"""Recording of a wave: signals of each sample of a batch, until they suffice or a guard ends them."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from calcidem.dem.engine.leapfrog import Kernel, State, run_in_place
from calcidem.dem.engine.readout import overlaps
from calcidem.dem.kernels.layout import LISTENED, XY, Floats, Integers, Recording, X, Y
from calcidem.dem.kernels.steps import advance_steps
from calcidem.dem.wave.guards import broken_bonds, problems_of
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.scene import RECEIVER, TRANSMITTER
from calcidem.dem.wave.section import Counts, Section, quantise

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
    """See `guards.problems_of`."""
    kernel: Kernel = advance_steps
    """Advances the samples: on the processor, or on a GPU."""
    counts: Counts = field(init=False)
    """(L, 2, X, S) motion across and along so far, see `Section`."""
    broken: Integers = field(init=False)
    """(L,) number of broken bonds."""

    def __post_init__(self) -> None:
        """Initialize the results."""
        self.counts = np.zeros((self.state.features.lanes, 2, len(self.listeners), 0), dtype=np.int32)
        self.broken = broken_bonds(self.state)

    def run(self, stop_when: Callable[[Section], bool], check: Callable[[], None]) -> list[Section]:
        """Sections of all samples, in their order; see `propagation.send_waves`."""
        overlap = float(np.mean(np.maximum(overlaps(self.state), 0.0)))
        ended: dict[int, Section] = {}
        while len(ended) < self.samples:
            check()
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
