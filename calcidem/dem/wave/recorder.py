"""Recording a wave under way: the signals of each sample of a batch, until they are long enough or a guard steps in."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from calcidem.dem.engine.leapfrog import State, run_in_place
from calcidem.dem.engine.readout import overlaps
from calcidem.dem.kernels.layout import LISTENED, RECEIVED, XY, Floats, Integers, Recording, X, Y
from calcidem.dem.wave.guards import broken_bonds, cemented_bonds, problems_of
from calcidem.dem.wave.linearity import Nonlinearity, nonlinearity, slipped_force
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.scene import RECEIVER, TRANSMITTER

SAMPLES_PER_CHUNK = 50  # between two looks at the signal
LOOKS_APART = 2  # periods of the pulse between two looks at what the contact laws would change


@dataclass(frozen=True, slots=True)
class WaveRecord:
    """What one sample recorded; all signals are (S,), sampled at `times`.

    Attributes
    ----------
    time_step
        Of the integration, s.
    stride
        Time steps between two samples.
    sent
        Velocity of the transmitter, m/s.
    force
        Shear force on the receiver, positive upwards, half a time step before the velocities, N/m.
    velocity
        Mean velocity along y of the disks before the receiver, m/s.
    stability_limit
        Critical time step at the start, s.
    steps
        Time steps done for this sample.
    stations
        (S, X) mean velocity along y of the disks of each station, m/s; None without stations.
    along
        (S, X + 1) mean velocity along x of the disks of each station and of those before the receiver, m/s; None if it
        was not recorded.
    unbalanced_speed
        See `guards.unbalanced_speed`.
    closing_gaps
        Pairs of disks that do not touch and are no further apart than the stroke of the pulse, over the contacts; zero
        in the finite regime, where they may touch.
    broken_bonds, bonds
        Bonds that broke until then, of how many.
    remaining_speed
        Bound of the velocity from then on, m/s: that of its disks, were all that moves in the sample theirs.
    nonlinear
        What the contact laws would change when the pulse has been sent, and after every `LOOKS_APART` periods from then
        on.
    slipped
        Largest part of the transmitter's force, while the pulse was sent, that its contacts could not have passed on.
    problem
        Empty, or why the run cannot be trusted.
    retry
        Empty, or the problem for which the sample was sent a second time, with half the step.
    """

    time_step: float
    stride: int
    sent: Floats
    force: Floats
    velocity: Floats
    stability_limit: float
    steps: int
    stations: Floats | None = None
    along: Floats | None = None
    unbalanced_speed: float = 0.0
    closing_gaps: float = 0.0
    broken_bonds: int = 0
    bonds: int = 0
    remaining_speed: float = np.inf
    nonlinear: tuple[Nonlinearity, ...] = ()
    slipped: float = 0.0
    problem: str = ""
    retry: str = ""

    @property
    def sampling_interval(self) -> float:
        """Time between two samples, s."""
        return self.stride * self.time_step

    @property
    def start_time(self) -> float:
        """Time of the first sample, s: half a time step before `sampling_interval`."""
        return float(_sample_times(0, 1, self.stride, self.time_step)[0])

    @property
    def times(self) -> Floats:
        """(S,) times of the samples, s."""
        return _sample_times(0, len(self.sent), self.stride, self.time_step)

    @property
    def duration(self) -> float:
        """Time that has been recorded, s."""
        return len(self.sent) * self.sampling_interval


def _sample_times(begin: int, end: int, stride: int, time_step: Floats | float) -> Floats:
    """Times of some samples, s: (S,), or (L, S) for steps (L, 1).

    A sample is taken at the end of every stride-th step: leapfrog velocities belong to the middle of that step.
    """
    return np.asarray(((np.arange(begin, end) + 1) * stride - 0.5) * time_step)


@dataclass(slots=True)
class Recorder:
    """A batch of samples that a pulse is sent through, advanced chunk by chunk.

    Attributes
    ----------
    state
        Just started; each sample has a lane.
    pulse
        What the transmitter does.
    stride
        Time steps between two samples of the signals.
    listeners
        Disks whose mean velocity along y is recorded: those before the receiver, and those of each station; in memory
        order.
    driven_disks
        Disks that the pulse drives, in memory order.
    samples
        Number of samples; further lanes are not looked at.
    longest
        Time after which a record ends in any case, s.
    unbalanced_speed
        (L,) see `WaveRecord`.
    closing_gaps
        See `WaveRecord`.
    breakable
        See `guards.problems_of`.
    along
        Whether their velocities along x are recorded, too.
    signals
        (L, 3 + X, S) so far: sent, force and velocity of `WaveRecord`, and velocities of its stations; then those along
        x of receiver and stations, if they are recorded.
    nonlinear, slipped, bonds, broken
        See `WaveRecord`, for each sample and, the latter three, each lane; ``broken`` are its broken bonds.
    """

    state: State
    pulse: Pulse
    stride: int
    listeners: tuple[Integers, ...]
    driven_disks: Integers
    samples: int
    longest: float
    unbalanced_speed: Floats
    closing_gaps: float
    breakable: float = 0.0
    along: bool = False
    signals: Floats = field(init=False)
    nonlinear: list[list[Nonlinearity]] = field(init=False)
    slipped: Floats = field(init=False)
    bonds: Integers = field(init=False)
    broken: Integers = field(init=False)

    def __post_init__(self) -> None:
        """Know nothing of the wave yet."""
        self.nonlinear = [[] for _ in range(self.samples)]
        self.signals = np.zeros((self.state.features.lanes, 2 + len(self.axes), 0))
        self.slipped = np.zeros(self.state.features.lanes)
        self.bonds, self.broken = cemented_bonds(self.state), broken_bonds(self.state)

    @property
    def axes(self) -> Integers:
        """(G,) component of each velocity that is recorded: of all listeners along y, then along x if at all."""
        return np.repeat([Y, X] if self.along else [Y], len(self.listeners))

    @property
    def steps_per_look(self) -> int:
        """Time steps between two looks at the signals."""
        return SAMPLES_PER_CHUNK * self.stride

    def run(self, stop_when: Callable[[WaveRecord], bool], check: Callable[[], None]) -> list[WaveRecord]:
        """Records of all samples, in their order; see `propagation.send_waves`."""
        overlap = float(np.mean(np.maximum(overlaps(self.state), 0.0)))
        records: dict[int, WaveRecord] = {}
        while len(records) < self.samples:
            check()
            self.record_chunk()
            running = [lane for lane in range(self.samples) if lane not in records]
            self._look_at_contacts(running)
            problems = problems_of(self.state, self.pulse.amplitude, overlap, self.breakable)
            remaining = self._remaining_speeds()
            for lane in running:
                record = self.record_of(lane, problems[lane], float(remaining[lane]))
                if record.problem or record.duration >= self.longest or stop_when(record):
                    records[lane] = record
        return [records[lane] for lane in sorted(records)]

    def _look_at_contacts(self, running: Sequence[int]) -> None:
        """Find what the contact laws would change at the transmitter, and in the samples whose next look is due."""
        sending = [lane for lane in running if not self.nonlinear[lane]]
        if sending:
            now = slipped_force(self.state, TRANSMITTER)
            self.slipped[sending] = np.maximum(self.slipped, now)[sending]
        periods = self.state.steps * self.state.time_step / self.pulse.duration
        due = [lane for lane in running if periods[lane] >= 1.0 + LOOKS_APART * len(self.nonlinear[lane])]
        if due:
            found = np.array(nonlinearity(self.state, np.array(due)))
            for lane, values in zip(due, found.T.tolist(), strict=True):
                self.nonlinear[lane].append(Nonlinearity(*values))

    def record_chunk(self, samples: int = SAMPLES_PER_CHUNK) -> None:
        """Advance by so many samples."""
        steps, begin = samples * self.stride, self.signals.shape[2]
        dtype, lanes = self.state.motion.velocity.dtype, self.state.features.lanes
        groups = self.listeners * (2 if self.along else 1)
        middle = (self.state.steps + np.arange(steps)[:, None] + 0.5) * self.state.time_step
        recording = Recording(
            drive=self._sent_at(middle).astype(dtype),
            driven=-1 if len(self.driven_disks) else TRANSMITTER,
            driven_disks=self.driven_disks,
            offset=0,
            stride=self.stride,
            receiver=RECEIVER,
            listeners=np.concatenate(groups),
            groups=np.cumsum([0, *map(len, groups)]),
            axes=self.axes,
            samples=np.zeros((samples, 1 + len(groups), lanes), dtype),
        )
        self.state = run_in_place(self.state, steps, recording)
        self.broken = broken_bonds(self.state)
        times = _sample_times(begin, begin + samples, self.stride, self.state.time_step[:, None])
        received = recording.samples.astype(float)
        # The tangent of the right wall points down; a signal is positive when it pulls up, as it was sent.
        velocities = received[:, LISTENED:].transpose(2, 1, 0)
        chunk = self._sent_at(times)[:, None], -received[:, RECEIVED].T[:, None], velocities
        self.signals = np.concatenate([self.signals, np.concatenate(chunk, axis=1)], axis=2)

    def _sent_at(self, times: Floats) -> Floats:
        """Velocities of the transmitter at times, m/s; all at once where it is at rest again."""
        first = times.min()
        resting = self.pulse.frequency * first >= 1.0  # as `Pulse.velocity` asks
        return np.full(times.shape, self.pulse.velocity(first)) if resting else self.pulse.velocity(times)

    def _remaining_speeds(self) -> Floats:
        """(L,) see `WaveRecord.remaining_speed`, m/s.

        Half of the energy of waves is kinetic, on their way and at the receiver, and damping only takes from it. The
        mean velocity of n disks is highest where they move together: at ``sum(m v^2) / (n m)``, its square, at most.
        """
        mass = self.state.scene.mass[self.state.assembly.order]
        velocity = self.state.motion.velocity[:, XY].astype(float)
        moving = (mass[:, None, None] * (velocity * velocity)).sum(axis=0).sum(axis=0)
        return np.asarray(np.sqrt(moving / (len(self.listeners[0]) * mass[self.listeners[0]].min())))

    def record_of(self, lane: int, problem: str, remaining_speed: float = np.inf) -> WaveRecord:
        """What a lane has recorded so far, and why it cannot be trusted if it cannot."""
        sent, force = self.signals[lane, :2]
        across, along = np.split(self.signals[lane, 2:], [len(self.listeners)])
        return WaveRecord(
            time_step=float(self.state.time_step[lane]),
            stride=self.stride,
            sent=sent,
            force=force,
            velocity=across[0],
            stability_limit=float(self.state.critical_time_step[lane]),
            steps=self.state.steps,
            stations=across[1:].T if len(across) > 1 else None,
            along=np.roll(along, -1, axis=0).T if len(along) else None,
            unbalanced_speed=float(self.unbalanced_speed[lane]),
            closing_gaps=self.closing_gaps,
            broken_bonds=int(self.broken[lane]),
            bonds=int(self.bonds[lane]),
            remaining_speed=remaining_speed,
            nonlinear=tuple(self.nonlinear[lane]),
            slipped=float(self.slipped[lane]),
            problem=problem,
        )
