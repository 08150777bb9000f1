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

from calcidem.dem.kernels.layout import Floats, Integers, Recording
from calcidem.dem.material import Cement, Sand, require
from calcidem.dem.packing import Packing
from calcidem.dem.pulse import pulse_velocity
from calcidem.dem.scene import Bonds, Installation, Regime, Scene, Wall
from calcidem.dem.state import Precision, State, choose_features, run_sweep, start

Flags: TypeAlias = npt.NDArray[np.bool_]

LEFT_BELOW, TRANSMITTER, LEFT_ABOVE, RIGHT_BELOW, RECEIVER, RIGHT_ABOVE, FLOOR, LID = range(8)
SAMPLES_PER_PERIOD = 100  # at least; a parabola through the peak is then good to 1e-5 of the period
SAMPLES_PER_CHUNK = 50  # between two looks at the signal
BLOW_UP = 1e3  # velocity over that of the pulse at which a run has gone wrong; waves stay below about 5


@dataclass(frozen=True, slots=True)
class WaveRule:
    """How the wave is sent, carried and recorded.

    Attributes
    ----------
    amplitude
        v0 of ``v(t) = v0 (1 - cos 2 pi f t)``, m/s.
    transmitter_half_width, receiver_half_width
        Of the bands, m.
    band_friction
        Coulomb coefficient of the two bands.
    damping
        Local damping factor of the sample.
    boundary_damping, boundary_thickness
        Local damping factor of the layers at floor and lid, and their thickness in m.
    regime
        See `state.start`.
    precision
        Of the kernel's arrays.
    step_fraction
        Time step as a part of the stability limit.
    slowest
        Slowest velocity that is waited for, m/s: the longest record is distance / slowest + two periods.
    listening_depth
        Disks this far from the receiving wall, but not touching it, make up the recorded velocity, m.
    """

    amplitude: float = 1.0e-5
    transmitter_half_width: float = 0.01
    receiver_half_width: float = 0.03
    band_friction: float = 0.7
    damping: float = 0.3
    boundary_damping: float = 1.0
    boundary_thickness: float = 0.05
    regime: Regime = "linear"
    precision: Precision = "float64"
    step_fraction: float = 0.8
    slowest: float = 60.0
    listening_depth: float = 0.01

    def __post_init__(self) -> None:
        """Refuse what cannot be sent."""
        for name in ("amplitude", "transmitter_half_width", "receiver_half_width", "slowest", "listening_depth"):
            require(getattr(self, name) > 0.0, name, getattr(self, name), "give a positive number")
        for name in ("damping", "boundary_damping"):
            require(0.0 <= getattr(self, name) <= 1.0, name, getattr(self, name), "give a factor in [0, 1]")
        require(self.band_friction > 0.0, "band_friction", self.band_friction, "a smooth transmitter moves nothing; give a positive coefficient")
        require(self.boundary_thickness >= 0.0, "boundary_thickness", self.boundary_thickness, "give 0 or more, in m")
        require(0.0 < self.step_fraction <= 1.0, "step_fraction", self.step_fraction, "above 1 the scheme is unstable; choose 0.05 to 0.95")


@dataclass(frozen=True, slots=True)
class WaveRecord:
    """What one sample recorded; all signals are (S,) and begin at ``interval``.

    Attributes
    ----------
    interval
        Time between two samples, s.
    sent
        Velocity of the transmitter, m/s.
    force
        Shear force on the receiver, N/m.
    velocity
        Mean velocity along y of the disks before the receiver, m/s.
    time_step, stability_limit
        s.
    steps
        Time steps done for this sample.
    problem
        Empty, or why the run cannot be trusted.
    """

    interval: float
    sent: Floats
    force: Floats
    velocity: Floats
    time_step: float
    stability_limit: float
    steps: int
    problem: str = ""


def wave_scene(packing: Packing, sand: Sand, rule: WaveRule, bonds: Bonds | None) -> Scene:
    """The packing between transmitter and receiver."""
    width, height, middle = packing.width, packing.height, packing.height / 2.0
    for name in ("transmitter_half_width", "receiver_half_width"):
        half = getattr(rule, name)
        require(half < middle, name, half, f"has to be less than half the height of the sample, {middle:.4g} m")
    require(
        rule.boundary_thickness < middle, "boundary_thickness", rule.boundary_thickness, f"has to be less than half the height of the sample, {middle:.4g} m"
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
        Wall((0.0, height), (0.0, -1.0)),
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


def listening_disks(packing: Packing, rule: WaveRule) -> Integers:
    """Disks in the receiver's band, near the wall but not touching it."""
    gap = packing.width - packing.x - packing.radius
    in_band = np.abs(packing.y - packing.height / 2.0) < rule.receiver_half_width
    return np.flatnonzero(in_band & (gap > 0.0) & (packing.width - packing.x < rule.listening_depth))


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
    return max(1, int(1.0 / (frequency * SAMPLES_PER_PERIOD * rule.step_fraction * limit)))


def peak_is_past(signal: Floats, pulse: int) -> bool:
    """Whether the record goes on long enough after its largest deflection, of either sign.

    The compression wave runs ahead of the shear wave, less than twice as fast, and deflects the other way. A record
    2.5 times as long as its largest deflection is late, and a pulse and a half longer, holds the shear wave's peak
    even if the largest so far was the forerunner's.
    """
    return len(signal) > 2.5 * int(np.argmax(np.abs(signal))) + 1.5 * pulse


def send_waves(
    packing: Packing,
    sand: Sand,
    cement: Cement,
    bonded: Sequence[Flags],
    frequency: float,
    rule: WaveRule,
    *,
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
    lanes
        Width of the kernel. A sample's bits do not depend on how many of the lanes are in use.
    installation
        See `scene.Bonds`.
    check
        Called every fraction of a second; may raise to end the run.

    Returns
    -------
    One record for each sample. A record ends, at times of its own, when its peak is safely past.
    """
    require(0 < len(bonded) <= lanes, "bonded", len(bonded), f"give 1 to {lanes} samples")
    bonds = lane_bonds(packing, cement, bonded, lanes, installation)
    scene = wave_scene(packing, sand, rule, bonds)
    features = replace(choose_features(scene, rule.regime, lanes), recording=True, search=False)
    state = start(
        scene, features=features, precision=rule.precision, preload=packing.preload, step_fraction=rule.step_fraction
    )
    stride = samples_stride(packing, sand, rule, bonds, frequency)
    listeners = listening_disks(packing, rule)
    return Recorder(state, frequency, rule, stride, listeners, len(bonded)).run(packing.width, check)


class Recorder:
    """Advances a batch chunk by chunk and gathers the signals of each lane until it has heard enough."""

    def __init__(
        self, state: State, frequency: float, rule: WaveRule, stride: int, listeners: Integers, samples: int
    ) -> None:
        self.state = state
        self.frequency = frequency
        self.rule = rule
        self.stride = stride
        rank = np.argsort(state.assembly.order)
        self.listeners = np.sort(rank[listeners])
        self.open = set(range(samples))
        self.signals: list[Floats] = []
        self.records: dict[int, WaveRecord] = {}

    def run(self, distance: float, check: Callable[[], None]) -> list[WaveRecord]:
        """Records of all samples, in their order."""
        longest = distance / self.rule.slowest + 2.0 / self.frequency
        while self.open:
            check()
            self.signals.append(self.chunk())
            self.state = replace(self.state, steps=self.state.steps + SAMPLES_PER_CHUNK * self.stride)
            for lane in sorted(self.open):
                self.look_at(lane, longest)
        return [self.records[lane] for lane in sorted(self.records)]

    def chunk(self) -> Floats:
        """Advance by one chunk; (samples, 2, L) shear force and velocity."""
        steps = SAMPLES_PER_CHUNK * self.stride
        dtype, lanes = self.state.motion.velocity.dtype, self.state.features.lanes
        middle = (self.state.steps + np.arange(steps)[:, None] + 0.5) * self.state.time_step
        recording = Recording(
            drive=pulse_velocity(middle, self.rule.amplitude, self.frequency).astype(dtype),
            driven=TRANSMITTER,
            stride=self.stride,
            receiver=RECEIVER,
            listeners=self.listeners,
            samples=np.zeros((SAMPLES_PER_CHUNK, 2, lanes), dtype),
        )
        run_sweep(self.state, steps, recording)
        return recording.samples

    def look_at(self, lane: int, longest: float) -> None:
        """Close the record of a lane that is done or in trouble."""
        record = self.record_of(lane)
        time = len(record.sent) * record.interval
        pulse = round(1.0 / (self.frequency * record.interval))
        past = peak_is_past(record.force, pulse) and peak_is_past(record.velocity, pulse)
        if record.problem or past or time >= longest:
            self.records[lane] = record
            self.open.discard(lane)

    def record_of(self, lane: int) -> WaveRecord:
        """What a lane has recorded so far."""
        signals = np.concatenate([chunk[:, :, lane] for chunk in self.signals]).astype(float)
        step = float(self.state.time_step[lane])
        # A sample is taken at the end of every stride-th step; its force belongs to the beginning of that step.
        time = ((np.arange(len(signals)) + 1) * self.stride - 1) * step
        fastest = float(np.abs(self.state.motion.velocity[:, :2, lane]).max())
        problem = ""
        if not np.isfinite(fastest) or fastest > BLOW_UP * self.rule.amplitude:
            problem = f"unstable: a disk moves at {fastest:.3g} m/s after {self.state.steps} steps"
        return WaveRecord(
            interval=self.stride * step,
            sent=pulse_velocity(time, self.rule.amplitude, self.frequency),
            # The tangent of the right wall points down; a signal is positive when it pulls up, as it was sent.
            force=-signals[:, 0],
            velocity=signals[:, 1],
            time_step=step,
            stability_limit=float(self.state.limit[lane]),
            steps=self.state.steps,
            problem=problem,
        )
