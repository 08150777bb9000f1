"""Numerical error that a velocity has to state, from its record and settings alone.

The factors were measured against converged runs of the same cells (docs/accuracy.md).
"""

import numpy as np

from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.recorder import WaveRecord

TURNING = 3.0  # error of a fixed geometry over (mean overlap / mean radius)
STIFFENING = 3.0e-3  # error of constant stiffnesses over (stroke of the pulse / mean overlap)
SLIP = 0.8  # error of contacts that do not slip over `slip_ratio` cubed
CLOSING = 0.5  # error of contacts that may not close over `WaveRecord.closing_gaps`
CHATTER = 7.5e-3  # error of strong local damping, see `chatter_error`
SAMPLING = 0.2  # error of an arrival over the interval between samples; 0.13 was the largest found
IMBALANCE = 20.0  # error of a packing that is not quite at rest over `WaveRecord.unbalanced_speed`
SINGLE_PRECISION = 1.0e-3  # error of single precision


def numerical_error(
    experiment: Experiment, record: WaveRecord, frequency: float, travel_time: float, *, noisy: bool = False
) -> float:
    """Estimated relative error of a velocity by step, sampling, regime, precision, noise, damping and imbalance.

    Seven parts that have nothing to do with one another, added as such (root of the sum of squares), each so large
    that it covers 95 % of the cells it was measured on.

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
    sampling = SAMPLING * record.sampling_interval / travel_time
    precision = SINGLE_PRECISION if wave.precision == "float32" else 0.0
    # These change the shape of the signal and so move a peak by a part of the period, which weighs more on a short way.
    shape = max(1.0, 1.0 / (frequency * travel_time))
    noise = experiment.pick.onset / (np.pi * frequency * travel_time) if noisy else 0.0
    geometry = geometry_error(experiment, frequency) + CLOSING * record.closing_gaps
    regime = shape * geometry + slip_error(experiment, frequency, travel_time)
    rest = shape * precision, noise, chatter_error(experiment, record), IMBALANCE * record.unbalanced_speed
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
