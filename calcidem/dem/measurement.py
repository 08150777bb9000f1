"""From a seed and a content to a shear-wave velocity: cement the packing, send the wave, read its arrival."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from time import perf_counter
from typing import Literal

import numpy as np

from calcidem.dem.arrival import PickFailure, PickRule, Picks, Signals, arrived, read_arrival
from calcidem.dem.cement import CementOrdering, CementRule, PlacedCement, draw_cement
from calcidem.dem.material import Cement, Sand, require
from calcidem.dem.packing import Packing
from calcidem.dem.pulse import excitation_frequency
from calcidem.dem.scene import Installation
from calcidem.dem.wave import WaveRecord, WaveRule, send_waves

TURNING = 3.0  # error of a fixed geometry over (mean overlap / mean radius)
STIFFENING = 3.0e-3  # error of constant stiffnesses over (stroke of the pulse / mean overlap)
SLIP = 0.8  # error of contacts that do not slip over `slip_ratio` cubed
CLOSING = 0.5  # error of contacts that may not close over `WaveRecord.closing`
SAMPLING = 0.2  # error of an arrival over the interval between samples; 0.13 was the largest found
CHATTER = 7.5e-3  # error of strong local damping, see `chatter_error`
IMBALANCE = 20.0  # error of a packing that is not quite at rest over `WaveRecord.unrest`
SINGLE_PRECISION = 1.0e-3  # error of single precision
LARGEST_ERROR = 0.05  # estimate above which a velocity is not trusted
INEXACT = "the estimated numerical error is above 5 %: lower wave.amplitude, or choose regime = finite"
NOISY = "the estimated numerical error is above 5 %: noise moves the peak; lower wave.amplitude or the frequency"
SILENCE = 1e-3  # received velocity over the amplitude of the pulse; real arrivals are above 2e-2
MUTED = 1e-2  # the same where damping leaves so little of a pulse that its remains have several tops
MUTING = 0.6  # sample damping above which that is so: scenes with 0.62 and 0.68 changed Vs by 8 and 11 % with the step

Method = Literal["peak", "first_arrival", "cross_correlation"]
ReceivedSignal = Literal["velocity", "force"]


class Outcome(StrEnum):
    """What became of a sample."""

    DONE = "done"
    NO_ARRIVAL = "no_arrival"
    UNSTABLE = "unstable"


@dataclass(frozen=True, slots=True)
class Experiment:
    """Everything that all samples of a campaign share.

    Attributes
    ----------
    packing, sand, cement, cement_rule, wave, pick
        See their classes.
    root_seed
        Root of all random numbers of the campaign.
    stiffness_factor
        Multiplies the grains' shear modulus, and with it all contact forces and the confining stress, in the wave
        stage. 1 is the packing as it was made; anything else is a calibration.
    installation
        See `scene.Bonds`.
    method
        Reading that becomes Vs.
    least_quality
        Readings of lower quality are not trusted.
    early_stop
        End a record as soon as its reading is settled; it does not change the reading.
    signal
        Received signal that is read.
    frequencies
        (contents in percent, frequencies in Hz), interpolated between; None takes Table 2 of the paper.
    """

    packing: Packing
    sand: Sand = field(default_factory=Sand)
    cement: Cement = field(default_factory=Cement)
    cement_rule: CementRule = field(default_factory=CementRule)
    wave: WaveRule = field(default_factory=WaveRule)
    pick: PickRule = field(default_factory=PickRule)
    root_seed: int = 0
    stiffness_factor: float = 1.0
    installation: Installation = "preserve"
    method: Method = "peak"
    signal: ReceivedSignal = "velocity"
    least_quality: float = 0.1
    early_stop: bool = True
    frequencies: tuple[tuple[float, ...], tuple[float, ...]] | None = None

    def __post_init__(self) -> None:
        """Refuse what the linear regime cannot do and factors without meaning."""
        require(self.stiffness_factor > 0.0, "stiffness_factor", self.stiffness_factor, "give a positive factor")
        require(
            self.installation == "preserve" or self.wave.regime != "linear",
            "installation",
            self.installation,
            'changes the contact forces, which regime = "linear" takes as they are; choose "small" or "finite"',
        )

    def frequency(self, content: float) -> float:
        """Excitation frequency at a content (percent), Hz."""
        if self.frequencies is None:
            return excitation_frequency(content)
        return float(np.interp(content, *self.frequencies))

    def ordering(self, seed: int) -> CementOrdering:
        """Order in which the contacts and clusters of a seed are cemented."""
        packing = self.packing
        return draw_cement(
            np.asarray(packing.x, dtype=np.float64),
            np.asarray(packing.y, dtype=np.float64),
            np.asarray(packing.radius, dtype=np.float64),
            packing.pairs,
            box=(packing.width, packing.height),
            rule=self.cement_rule,
            seed=seed,
            root_seed=self.root_seed,
        )

    def stiffened(self) -> tuple[Packing, Sand]:
        """Packing and sand of the wave stage."""
        factor = self.stiffness_factor
        preload = replace(self.packing.preload, shear=self.packing.preload.shear * factor)
        left, right, floor, lid = self.packing.report.wall_stress
        stress = (factor * left, factor * right, factor * floor, factor * lid)
        report = replace(self.packing.report, wall_stress=stress)
        sand = replace(self.sand, shear_modulus=self.sand.shear_modulus * factor)
        return replace(self.packing, preload=preload, report=report), sand


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """What one sample gave.

    Attributes
    ----------
    seed, content
        Its identity; content in percent of the sand's mass, as wanted.
    outcome, reason
        What became of it, and why if there is no velocity.
    vs
        Shear-wave velocity by the experiment's method, m/s; None without a trusted pick.
    picks
        All readings, of the experiment's signal; None if the run was unstable.
    frequency
        Excitation, Hz.
    error_estimate
        Relative error of ``vs``, see `discretisation_error`; None without ``vs``.
    cement
        Where the cement is.
    record
        Signals and time step.
    seconds
        Wall time of this sample's share of its batch.
    """

    seed: int
    content: float
    outcome: Outcome
    reason: str
    vs: float | None
    picks: Picks | None
    frequency: float
    error_estimate: float | None
    cement: PlacedCement
    record: WaveRecord
    seconds: float


def measure(
    experiment: Experiment,
    content: float,
    seeds: Sequence[int],
    *,
    lanes: int = 8,
    check: Callable[[], None] = lambda: None,
    ordering: Callable[[int], CementOrdering] | None = None,
) -> tuple[Measurement, ...]:
    """Measure the samples of several seeds at one content, side by side.

    Parameters
    ----------
    experiment
        What they share.
    content
        Percent of the sand's mass.
    seeds
        At most ``lanes`` of them. What a seed gives does not depend on the others.
    lanes
        Width of the kernel.
    check
        Called every fraction of a second; may raise to end the run.
    ordering
        Stands for `Experiment.ordering`; one that remembers saves time where a seed is measured at many contents.

    Raises
    ------
    CementCapacityError
        If the content is more than the sample can hold.
    """
    began = perf_counter()
    placed = [(ordering or experiment.ordering)(seed).at(content) for seed in seeds]
    frequency = experiment.frequency(content)
    packing, sand = experiment.stiffened()

    def heard_enough(record: WaveRecord) -> bool:
        sent_all = len(record.sent) * record.interval > 1.0 / frequency
        return experiment.early_stop and sent_all and arrived(signals_of(record, experiment), experiment.pick)

    records = send_waves(
        packing,
        sand,
        experiment.cement,
        [cement.bonded for cement in placed],
        frequency,
        experiment.wave,
        heard_enough=heard_enough,
        lanes=lanes,
        installation=experiment.installation,
        check=check,
    )
    seconds = (perf_counter() - began) / len(seeds)
    return tuple(
        judged(experiment, seed, content, frequency, cement, record, seconds)
        for seed, cement, record in zip(seeds, placed, records, strict=True)
    )


def measure_all(
    experiment: Experiment,
    content: float,
    seeds: Sequence[int],
    *,
    lanes: int = 8,
    ordering: Callable[[int], CementOrdering] | None = None,
) -> tuple[Measurement, ...]:
    """Measure any number of seeds at one content, in batches as wide as the kernel; see `measure`."""
    found: list[Measurement] = []
    for begin in range(0, len(seeds), lanes):
        found += measure(experiment, content, seeds[begin : begin + lanes], lanes=lanes, ordering=ordering)
    return tuple(found)


def signals_of(record: WaveRecord, experiment: Experiment) -> Signals:
    """Signals of a record as the picking wants them.

    A received velocity below a small part of the sent one is silence. The force that belongs to it is that of a wave
    of the slowest velocity that is looked for, ``rho V v`` times the length of the receiver.
    """
    wave = experiment.wave
    floor = (MUTED if wave.damping > MUTING else SILENCE) * wave.amplitude
    if experiment.signal == "velocity":
        return Signals(record.interval, record.sent, record.velocity, experiment.packing.width, floor)
    floor *= experiment.sand.density * experiment.pick.slowest * 2.0 * wave.receiver_half_width
    return Signals(record.interval, record.sent, record.force, experiment.packing.width, floor)


def judged(
    experiment: Experiment,
    seed: int,
    content: float,
    frequency: float,
    cement: PlacedCement,
    record: WaveRecord,
    seconds: float,
) -> Measurement:
    """Read a record; whatever cannot be trusted becomes an outcome with its reason, never a number."""
    outcome, reason, vs, picks, error = Outcome.UNSTABLE, record.problem, None, None, None
    if not record.problem:
        picks = read_arrival(signals_of(record, experiment), experiment.pick)
        reading = getattr(picks, experiment.method)
        if reading.velocity is None or reading.travel_time is None:
            outcome, reason = Outcome.NO_ARRIVAL, str(reading.failure)
        elif reading.quality < experiment.least_quality:
            outcome = Outcome.NO_ARRIVAL
            reason = f"quality {reading.quality:.2f} of the pick is below {experiment.least_quality}"
        else:
            noisy = picks.first_arrival.failure == PickFailure.NOISE
            error = discretisation_error(experiment, record, frequency, reading.travel_time, noisy=noisy)
            if error > LARGEST_ERROR:
                outcome, error = Outcome.NO_ARRIVAL, None
                reason = NOISY if noisy else INEXACT
            else:
                outcome, vs = Outcome.DONE, reading.velocity
    return Measurement(seed, content, outcome, reason, vs, picks, frequency, error, cement, record, seconds)


def discretisation_error(
    experiment: Experiment, record: WaveRecord, frequency: float, travel_time: float, *, noisy: bool = False
) -> float:
    """Estimated relative error of a velocity by step, sampling, regime, precision, noise and imbalance.

    Seven parts that have nothing to do with one another, added as such (root of the sum of squares). Their factors were
    measured against converged runs of the same cells (docs/accuracy.md), each so that it covers 95 % of the cells.

    - Step: local damping looks at velocities half a step old, an error of first order; leapfrog shifts frequencies by
      ``(omega dt)^2 / 24``, and the shortest waves of a pulse have about three times its frequency.
    - Sampling: the smoothing before the pick spans a whole number of samples, so a peak that is not symmetric moves by
      a part of an interval.
    - Regime: see `geometry_error` and `slip_error`. Small and linear displacement keep gaps open that a pulse closes:
      each adds a contact near the transmitter for half of the time.
    - Precision: rounding of single precision moves broad peaks.
    - Noise: a pulse of height H falls off as ``H (1 - (pi f t)^2)`` from its peak, which noise n of the pulse's own
      frequency moves by ``n / (pi f H)``. It counts where it hides the first arrival, so that n is at least the
      onset level: chattering contacts make it, and another step another one.
    - Chatter: see `chatter_error`.
    - Imbalance: local damping works on the sum of all forces on a disk, and so sees what the packing left unbalanced.
    """
    wave = experiment.wave
    omega = 2.0 * np.pi * frequency
    step = 0.5 * record.time_step / travel_time + (3.0 * omega * record.time_step) ** 2 / 24.0
    sampling = SAMPLING * record.interval / travel_time
    precision = SINGLE_PRECISION if wave.precision == "float32" else 0.0
    # These change the shape of the signal and so move a peak by a part of the period, which weighs more on a short way.
    shape = max(1.0, 1.0 / (frequency * travel_time))
    noise = experiment.pick.onset / (np.pi * frequency * travel_time) if noisy else 0.0
    geometry = geometry_error(experiment, frequency) + CLOSING * record.closing
    regime = shape * geometry + slip_error(experiment, frequency, travel_time)
    rest = shape * precision, noise, chatter_error(experiment, record), IMBALANCE * record.unrest
    return float(np.linalg.norm([step, sampling, regime, *rest]))


def chatter_error(experiment: Experiment, record: WaveRecord) -> float:
    """Estimated relative error of a velocity by local damping of the stiffest contacts.

    Local damping of factor a takes the part 1 - a or 1 + a of a force, by the sign of the velocity. Near the stability
    limit the velocities of the stiffest contacts turn over at almost every step, and how often they do decides what is
    left of the wave. In lattices the error rose about as the cube of ``a / (1 - a)`` and steeply with the step.
    """
    damping = experiment.wave.damping
    return float(CHATTER * (damping / (1.0 - damping)) ** 3 * (record.time_step / record.stability_limit) ** 4)


def geometry_error(experiment: Experiment, frequency: float) -> float:
    """Estimated relative error of a velocity by geometry and stiffnesses that a regime takes for constant.

    - A loaded contact that turns pushes sideways with ``F_n / (k_n R)`` of its stiffness, in proportion to overlap over
      radius. A fixed geometry has none of that.
    - Constant stiffnesses also miss what the stroke of the pulse, compared with the overlap, changes.
    """
    wave, packing = experiment.wave, experiment.packing
    if wave.regime == "finite":
        return 0.0
    overlap = packing.report.mean_overlap
    turning = TURNING * overlap / float(np.mean(packing.radius))
    return turning + (STIFFENING * wave.amplitude / frequency / overlap if wave.regime == "linear" else 0.0)


def slip_error(experiment: Experiment, frequency: float, travel_time: float) -> float:
    """Estimated relative error of a velocity by contacts that do not slip in the linear regime.

    The share of contacts so weakly pressed that they slip rises with about the square of `slip_ratio`, and what each of
    them does not pass on in proportion to it.
    """
    if experiment.wave.regime != "linear":
        return 0.0
    return SLIP * slip_ratio(experiment, frequency, travel_time) ** 3


def slip_ratio(experiment: Experiment, frequency: float, travel_time: float) -> float:
    """Shear displacement of the contacts at the transmitter over that at which one of mean overlap slips.

    A contact there is a spring k_s that pulls at a medium of impedance ``rho V`` times the width d of a disk: of the
    stroke it takes ``x / sqrt(1 + x^2)`` with ``x = omega rho V d / k_s``. It slips at ``mu F_n / k_s``.
    """
    packing, sand, wave = experiment.packing, experiment.sand, experiment.wave
    radius, overlap = np.mean(packing.radius, keepdims=True), packing.report.mean_overlap
    hertz = experiment.stiffness_factor * float(sand.hertz_coefficient(radius)[0])
    shear = sand.shear_ratio * 1.5 * hertz * np.sqrt(overlap)
    impedance = sand.density * packing.width / travel_time * 2.0 * float(radius[0])
    x = 2.0 * np.pi * frequency * impedance / shear
    friction = min(sand.friction, wave.band_friction)
    taken = wave.amplitude / frequency * x / np.sqrt(1.0 + x * x)
    return float(taken / (friction * hertz * overlap**1.5 / shear)) if friction > 0.0 else np.inf
