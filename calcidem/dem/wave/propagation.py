"""The shear wave: transmitter and receiver on a cemented packing, and the record of what arrives.

Transmitter and receiver are bands of the side walls at mid-height. The transmitter slides along itself
for one pulse; the wave crosses the box and pulls at the receiver. Layers of strong damping at floor and
lid stand for the soil that goes on there (paper, section 2.2.2 and Fig. 4).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.assembly import near_pairs
from calcidem.dem.engine.material import Cement, Sand, require
from calcidem.dem.engine.readout import overlaps
from calcidem.dem.engine.scene import Bonds, Installation, Scene, Wall
from calcidem.dem.engine.state import SKIN, State, choose_features, run_in_place, start
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import Floats, Integers, Recording
from calcidem.dem.sample.packing import Packing
from calcidem.dem.sample.settling import settled
from calcidem.dem.wave.arrival import record_duration
from calcidem.dem.wave.domain import domain_of, listening_disks
from calcidem.dem.wave.guards import problems_of, unrest
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.rule import FEWEST_SAMPLES, WHOLE_DOMAIN, WaveRule, refuse_loud_pulse

__all__ = ["WaveRecord", "WaveRule", "samples_stride", "send_waves", "wave_scene"]

Flags: TypeAlias = npt.NDArray[np.bool_]
Signal: TypeAlias = npt.NDArray[np.float64]

LEFT_BELOW, TRANSMITTER, LEFT_ABOVE, RIGHT_BELOW, RECEIVER, RIGHT_ABOVE, FLOOR, LID = range(8)
SAMPLES_PER_CHUNK = 50  # between two looks at the signal
LARGEST_MOTION = 10.0  # displacement of a disk over the stroke of the pulse that is allowed for


@dataclass(frozen=True, slots=True)
class WaveRecord:
    """What one sample recorded; all signals are (S,), the first half a step before ``interval``.

    Attributes
    ----------
    interval
        Time between two samples, s.
    sent
        Velocity of the transmitter, m/s.
    force
        Shear force on the receiver, positive upwards, half a time step before the velocities, N/m.
    velocity
        Mean velocity along y of the disks before the receiver, m/s.
    time_step, stability_limit
        s.
    steps
        Time steps done for this sample.
    problem
        Empty, or why the run cannot be trusted.
    retry
        Empty, or the problem for which the sample was sent a second time, with half the step.
    unrest
        See `guards.unrest`.
    closing
        Pairs of disks that do not touch and are no further apart than the stroke of the pulse, over the contacts; zero
        in the finite regime, where they may touch.
    """

    interval: float
    sent: Signal
    force: Signal
    velocity: Signal
    time_step: float
    stability_limit: float
    steps: int
    problem: str = ""
    retry: str = ""
    unrest: float = 0.0
    closing: float = 0.0


def wave_scene(packing: Packing, sand: Sand, rule: WaveRule, bonds: Bonds | None) -> Scene:
    """The packing between transmitter and receiver."""
    width, height, middle = packing.width, packing.height, packing.height / 2.0
    for name in ("transmitter_half_width", "receiver_half_width"):
        half = getattr(rule, name)
        require(half < middle, name, half, f"has to be less than half the height of the sample, {middle:.4g} m")
    require(
        rule.boundary_thickness < middle,
        "boundary_thickness",
        rule.boundary_thickness,
        f"has to be less than half the height of the sample, {middle:.4g} m",
    )
    sent, heard = rule.transmitter_half_width, rule.receiver_half_width
    infinite = np.inf
    walls = (
        # The tangent of the left wall points up, that of the right wall down; both have their origin at mid-height.
        Wall((0.0, middle), (1.0, 0.0), span=(-infinite, -sent)),
        Wall((0.0, middle), (1.0, 0.0), friction=rule.band_friction, span=(-sent, sent)),
        Wall((0.0, middle), (1.0, 0.0), span=(sent, infinite)),
        Wall((width, middle), (-1.0, 0.0), span=(heard, infinite)),
        Wall((width, middle), (-1.0, 0.0), friction=rule.band_friction, span=(-heard, heard)),
        Wall((width, middle), (-1.0, 0.0), span=(-infinite, -heard)),
        Wall((0.0, 0.0), (0.0, 1.0)),
        # The servo of the lid works only while a cemented sample settles.
        Wall((0.0, height), (0.0, -1.0), servo_force=packing.report.wall_stress[-1] * width),
    )
    inside = np.abs(packing.y - middle) < middle - rule.boundary_thickness
    return Scene(
        x=packing.x,
        y=packing.y,
        radius=packing.radius,
        sand=sand,
        walls=walls,
        bonds=bonds,
        damping=np.where(inside, rule.damping, rule.boundary_damping),
    )


def lane_bonds(
    packing: Packing, cement: Cement, bonded: Sequence[Flags], lanes: int, installation: Installation
) -> Bonds | None:
    """Cement of all lanes as one set of bonds; None if no sample has any."""
    # Lanes that are not used repeat the first sample: no lane sees the others, and all compute something sane.
    filled = [*bonded, *[bonded[0]] * (lanes - len(bonded))]
    bits = sum(np.asarray(flags, dtype=np.uint32) << np.uint32(lane) for lane, flags in enumerate(filled))
    cemented = np.flatnonzero(bits)
    if not len(cemented):
        return None
    return Bonds(packing.pairs[cemented], cement, np.asarray(bits)[cemented], installation)


def samples_stride(packing: Packing, sand: Sand, rule: WaveRule, bonds: Bonds | None, frequency: float) -> int:
    """Steps between two samples, the same for all cells of one content.

    It is taken from the step of the fully cemented packing (or the bare one), so that it depends neither on the
    pattern of a cell nor on its neighbours in the batch.
    """
    every = None if bonds is None else replace(bonds, pairs=packing.pairs, lanes=None)
    scene = wave_scene(packing, sand, rule, every)
    limit = start(scene, features=choose_features(scene, rule.regime), preload=packing.preload).limit[0]
    return max(1, int(1.0 / (frequency * rule.samples_per_period * rule.step_fraction * limit)))


def send_waves(
    packing: Packing,
    sand: Sand,
    cement: Cement,
    bonded: Sequence[Flags],
    frequency: float,
    rule: WaveRule,
    *,
    heard_enough: Callable[[WaveRecord], bool],
    lanes: int = 8,
    installation: Installation = "preserve",
    check: Callable[[], None] = lambda: None,
) -> list[WaveRecord]:
    """Send one pulse through each of several samples, side by side.

    Parameters
    ----------
    packing, sand, cement
        What all samples share.
    bonded
        For each sample the truth values (C,) of the ``packing.pairs`` that are cemented; at most ``lanes`` samples.
    frequency
        Hz.
    rule
        How.
    heard_enough
        Asked of each sample at fixed times of its own; the record ends where the answer is yes.
    lanes
        Width of the kernel. A sample's bits do not depend on how many of the lanes are in use.
    installation
        See `scene.Bonds`.
    check
        Called every fraction of a second; may raise to end the run.

    Returns
    -------
    One record for each sample. A sample in which a guard found a problem is sent once more with half the step, and its
    record says so; if that fails too, the problem stays in the record.

    Raises
    ------
    ValueError
        If the pulse is too strong for the regime.
    """
    refuse_loud_pulse(packing, rule, frequency)

    def send(samples: Sequence[Flags], chosen: WaveRule) -> list[WaveRecord]:
        recorder = prepared(packing, sand, cement, samples, frequency, chosen, heard_enough, lanes, installation, check)
        return recorder.run(packing.width, check)

    records = send(bonded, rule)
    failed = [sample for sample, record in enumerate(records) if record.problem]
    if failed:
        finer = send([bonded[sample] for sample in failed], replace(rule, step_fraction=0.5 * rule.step_fraction))
        for sample, record in zip(failed, finer, strict=True):
            records[sample] = replace(record, retry=records[sample].problem)
    return records


def prepared(
    packing: Packing,
    sand: Sand,
    cement: Cement,
    bonded: Sequence[Flags],
    frequency: float,
    rule: WaveRule,
    heard_enough: Callable[[WaveRecord], bool],
    lanes: int,
    installation: Installation,
    check: Callable[[], None],
) -> "Recorder":
    """Batch that is ready to be sent, once and with one step; the arguments are those of `send_waves`."""
    require(0 < len(bonded) <= lanes, "bonded", len(bonded), f"give 1 to {lanes} samples")
    closing = 0.0 if rule.regime == "finite" else closing_pairs(packing, Pulse(rule.amplitude, frequency).stroke)
    domain = domain_of(packing, rule, installation)
    packing, bonded = domain.packing, [flags[domain.pairs] for flags in bonded]
    bonds = lane_bonds(packing, cement, bonded, lanes, installation)
    scene = replace(wave_scene(packing, sand, rule, bonds), held=domain.held)
    features = wave_features(scene, rule, packing, frequency, lanes)
    state = start(
        scene,
        features=features,
        precision=rule.precision,
        preload=packing.preload,
        step_fraction=rule.step_fraction,
        skin_fraction=wave_skin(packing, rule, frequency),
    )
    if bonds is not None and installation != "preserve":
        state = settled(state, rule.unbalanced_force_ratio, rule.most_settling_steps, check)
    restless = unrest(state, rule.amplitude)
    longest_step = float(state.time_step.max())
    require(
        longest_step * frequency * FEWEST_SAMPLES <= 1.0,
        "frequency",
        frequency,
        f"the pulse is shorter than {FEWEST_SAMPLES} time steps of {longest_step:.3g} s, far above what the sample "
        "lets through: choose a lower frequency",
    )
    stride = samples_stride(packing, sand, rule, bonds, frequency)
    listeners = listening_disks(packing, rule)
    return Recorder(state, frequency, rule, stride, listeners, len(bonded), heard_enough, restless, closing)


def closing_pairs(packing: Packing, stroke: float) -> float:
    """Pairs with a gap below the stroke of a pulse, over the contacts: they may touch while it passes."""
    near = near_pairs(np.column_stack([packing.x, packing.y]), np.asarray(packing.radius, dtype=float), stroke)
    return max(0.0, len(near) / max(1, len(packing.pairs)) - 1.0)


def wave_features(scene: Scene, rule: WaveRule, packing: Packing, frequency: float, lanes: int) -> Features:
    """What the wave needs of the kernel, and what the rule keeps all the same."""
    # A pulse that moves the grains little needs no contact search: the pairs that can meet are listed from the start.
    search = rule.regime == "finite" and wave_skin(packing, rule, frequency) >= SKIN
    features = replace(choose_features(scene, rule.regime, lanes), recording=True, servo=False, search=search)
    return replace(features, **{name: True for name in rule.keep if name != WHOLE_DOMAIN})


def wave_skin(packing: Packing, rule: WaveRule, frequency: float) -> float:
    """How far apart, in mean radii, two disks may be that meet during the pulse; not more than `state.SKIN`."""
    motion = LARGEST_MOTION * Pulse(rule.amplitude, frequency).stroke
    return min(SKIN, 2.0 * motion / float(packing.radius.mean()))


class Recorder:
    """Advances a batch chunk by chunk and gathers the signals of each lane until it has heard enough."""

    def __init__(
        self,
        state: State,
        frequency: float,
        rule: WaveRule,
        stride: int,
        listeners: Integers,
        samples: int,
        heard_enough: Callable[[WaveRecord], bool],
        restless: Floats,
        closing: float,
    ) -> None:
        self.state = state
        self.restless = restless
        self.closing = closing
        self.pulse = Pulse(rule.amplitude, frequency)
        self.rule = rule
        self.heard_enough = heard_enough
        self.stride = stride
        self.steps_per_look = SAMPLES_PER_CHUNK * stride
        self.overlap = float(np.mean(np.maximum(overlaps(state), 0.0)))
        rank = np.argsort(state.assembly.order)
        self.listeners = np.sort(rank[listeners])
        self.open = set(range(samples))
        self.signals: list[Floats] = []
        self.records: dict[int, WaveRecord] = {}

    def run(self, distance: float, check: Callable[[], None]) -> list[WaveRecord]:
        """Records of all samples, in their order."""
        longest = record_duration(distance, self.rule.slowest, self.pulse.frequency)
        while self.open:
            check()
            self.signals.append(self.chunk())
            problems = problems_of(self.state, self.rule.amplitude, self.overlap)
            for lane in sorted(self.open):
                self.look_at(lane, problems[lane], longest)
        return [self.records[lane] for lane in sorted(self.records)]

    def chunk(self) -> Floats:
        """Advance by one chunk; (samples, 2, L) shear force and velocity."""
        steps = self.steps_per_look
        dtype, lanes = self.state.motion.velocity.dtype, self.state.features.lanes
        middle = (self.state.steps + np.arange(steps)[:, None] + 0.5) * self.state.time_step
        recording = Recording(
            drive=self.pulse.velocity(middle).astype(dtype),
            driven=TRANSMITTER,
            offset=0,
            stride=self.stride,
            receiver=RECEIVER,
            listeners=self.listeners,
            samples=np.zeros((SAMPLES_PER_CHUNK, 2, lanes), dtype),
        )
        self.state = run_in_place(self.state, steps, recording)
        return recording.samples

    def look_at(self, lane: int, problem: str, longest: float) -> None:
        """Close the record of a lane that is done or in trouble."""
        record = self.record_of(lane, problem)
        time = len(record.sent) * record.interval
        if record.problem or time >= longest or self.heard_enough(record):
            self.records[lane] = record
            self.open.discard(lane)

    def record_of(self, lane: int, problem: str) -> WaveRecord:
        """What a lane has recorded so far, and why it cannot be trusted if it cannot."""
        signals = np.concatenate([chunk[:, :, lane] for chunk in self.signals]).astype(float)
        step = float(self.state.time_step[lane])
        # A sample is taken at the end of every stride-th step: leapfrog velocities belong to the middle of that step.
        time = ((np.arange(len(signals)) + 1) * self.stride - 0.5) * step
        return WaveRecord(
            interval=self.stride * step,
            sent=self.pulse.velocity(time),
            # The tangent of the right wall points down; a signal is positive when it pulls up, as it was sent.
            force=-signals[:, 0],
            velocity=signals[:, 1],
            time_step=step,
            stability_limit=float(self.state.limit[lane]),
            steps=self.state.steps,
            problem=problem,
            unrest=float(self.restless[lane]),
            closing=self.closing,
        )
