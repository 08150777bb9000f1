"""Numerical error of a velocity from its record and settings alone: expected size, and bound.

Each part has a derived form and a factor measured against converged runs of the same cells. docs/accuracy.md has these
measurements, and a check on other cells and packings.
"""

from typing import NamedTuple

import numpy as np

from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.reading import ONSET, Reading
from calcidem.dem.wave.recorder import LOOKS_APART
from calcidem.dem.wave.section import Nonlinearity, Section

_USUAL = 0.1  # over the bound, for parts whose usual size has not been measured
_WORST_OF_HUNDRED = 4.6  # over the mean of the exponential distribution fitted to errors: ln(100)


class ErrorParts(NamedTuple):
    """Bounds of the independent parts of the relative error of a velocity."""

    step: float
    """Local damping a uses velocities half a step old. This error of first order is ``dt / 2`` of the travel time
    (docs/accuracy.md, "Order of convergence in the step"), multiplied by 1 / (1 - a), by which damping slows a wave
    that loads contacts (benchmarks/accuracy/drawn.py). Leapfrog has ``sin(omega' dt / 2) = omega dt / 2``, which shifts
    frequencies by ``(omega dt)^2 / 24``. The shortest waves of a pulse have about 3 f.
    """
    sampling: float
    """The smoothing before the pick spans a whole number of samples, so an asymmetric peak shifts by a part of an
    interval. The factor is 1.5 times the largest shift found.
    """
    regime: float
    """Constant geometry and stiffnesses of a regime (docs/accuracy.md, "Amplitude of the pulse").

    - A loaded contact that rotates by ``u / (2 R)`` gains the lateral force ``F_n / (2 R)`` per displacement u. With
      Hertz's ``F_n = (2/3) k_n d`` this is ``d / (3 R)`` of its stiffness at overlap d. A fixed geometry neglects it.
    - Constant stiffnesses also neglect the change by the pulse: ``k_n`` scales with the square root of the overlap.
    - Gaps that a pulse closes stay open. Each would add a contact near the transmitter for half of the time.
    - For rescaling see `section.Nonlinearity.rescaling`; a velocity scales with the square root of stiffness.
    """
    slip: float
    """Slip that the linear regime neglects; 1 is no bound.

    - A velocity scales with the square root of the stiffness, which slip reduces by `section.Nonlinearity.softening`.
      The error would be half of it if all contacts lost the same share. Here it is doubled (docs/stability.md, "near
      isostaticity"). On a path of less than a wavelength slip changes the shape.
    - For the loss at the transmitter see `_loss_error`.

    Contacts slip if the pulse is strong compared with their reserve up to the friction limit, or they have no reserve.
    """
    precision: float
    """Rounding of single precision moves broad peaks (docs/accuracy.md, "Every setting"). It also adds 2^-24 of the
    packing's contact forces, which scale with its overlap. The forces of the wave scale with the stroke of the pulse
    and the received part of its amplitude.
    """
    noise: float
    """A pulse of amplitude H falls off as ``H (1 - (pi f t)^2)`` from its peak. Noise n of the same frequency adds a
    slope of up to ``2 pi f n``, so the sum peaks at ``n / (pi f H)``. It counts if it hides the first arrival, so n is
    at least the onset level. Chattering contacts cause it, and another step causes other noise.
    """
    chatter: float
    """Local damping of factor a multiplies a force by 1 - a or 1 + a, depending on the sign of the velocity. Near the
    stability limit the velocities of the stiffest contacts reverse at almost every step. The frequency of reversals
    determines the amplitude of the wave. In lattices where nothing `chatters`, the error rises about as the cube of
    ``a / (1 - a)`` and steeply with the step (docs/stability.md, "Drawn at random").
    """
    unbalanced: float
    """Local damping acts on the sum of all forces on a disk, including unbalanced forces of the packing. The error is
    proportional to their ratio to the forces of the wave (docs/accuracy.md, "Amplitude of the pulse").
    """
    breaking: float
    """Bonds so close to failure that another step breaks others. If n of N bonds break, the count scatters by about
    ``sqrt(n)``, as for rare events. A bond contributes at most 1 / N of the stiffness of all bonds. However, bonds
    break near the transmitter, where each counts for more (docs/accuracy.md, "The error to expect").
    """


def error_bound(parts: ErrorParts) -> float:
    """Bound of the relative error of a velocity: root of the sum of squares of its parts."""
    return float(np.sqrt(sum(part * part for part in parts)))


_CURES = {
    "step": "make step_fraction smaller",
    "sampling": "make samples_per_period larger",
    "slip": "contacts slip, unlike in the linear regime; choose regime = 'finite', or a lower amplitude",
    "precision": "choose precision = 'float64'",
    "noise": "noise moves the peak; lower amplitude or the frequency",
    "chatter": "make step_fraction or damping smaller",
    "unbalanced": "raise amplitude, or make the packing's unbalanced_force_ratio smaller",
    "breaking": "bonds break at random; lower amplitude",
}


def _largest_part(experiment: Experiment, parts: ErrorParts, most: float) -> str:
    """Name of the part of a bound to reduce; ``most`` is the largest allowed bound."""
    if error_bound(parts) <= most:  # then the signal's shape causes the error
        return "regime" if experiment.wave.regime == "linear" else "noise"
    return max(parts._fields, key=lambda name: getattr(parts, name))


def cure_of(experiment: Experiment, parts: ErrorParts, most: float) -> str:
    """Remedy for the largest part of a bound; ``most`` is the largest allowed bound."""
    largest = _largest_part(experiment, parts, most)
    if largest != "regime":
        return _CURES[largest]
    if _turning_error(experiment) > most:
        return "the contacts overlap too far for a fixed geometry, at any amplitude; choose regime = 'finite'"
    return "lower amplitude, or choose regime = 'finite'"


def estimate_error(
    experiment: Experiment, section: Section, reading: Reading, chatter: float | None = None
) -> tuple[float, float, ErrorParts]:
    """Relative numerical error of a measured velocity: expected size, bound, and bounds of its parts.

    ``chatter`` is its measured relative change by halving the step, if any.

    The expected error is an order of magnitude. A change of the signal at the pulse's frequency, by the part e of its
    amplitude, tilts it by ``2 pi f e``. It moves a peak ``H (1 - t^2 / (2 w^2))`` by ``2 pi f e w^2``. The change is
    proportional to the nonlinear share in the linear regime, and to the roughness of the signal, since another step
    causes other chatter. An error of first order in the step over its limit adds to this, and a part of the rest of the
    bound. The bound is at least the value that one in a hundred such errors exceeds; the loss at the transmitter has
    its own bound.
    """
    frequency, travel_time = section.frequency, reading.travel_time
    shift = shift_by_change(section, reading)
    parts = _error_parts(experiment, section, reading, shift)
    weight = 1.0
    if chatter is not None:
        # Each of two runs with equal errors has 1 / sqrt(2) of their difference.
        parts = parts._replace(chatter=_WORST_OF_HUNDRED * 0.71 * chatter)
        weight = 1.0 / (_WORST_OF_HUNDRED * _USUAL)
    share = _largest_nonlinearity(section, frequency * travel_time).share
    # The signal changes near its peak by 1.7 of the share, and by a quarter of the motion that smoothing removes.
    change = 1.7 * share + 0.25 * reading.roughness
    others = parts.precision + parts.noise + weight * parts.chatter + parts.unbalanced + parts.breaking
    if experiment.wave.regime == "small":
        others += parts.regime
    step = 7.5e-5 * section.time_step / section.stability_limit
    usual = float(step + shift * change + _USUAL * others)
    # Slip at the transmitter shifts peaks in one direction, by 0.45 of its bound.
    loss = 0.45 * _loss_error(section, shift, frequency * travel_time)
    return usual + loss, max(error_bound(parts), _WORST_OF_HUNDRED * usual), parts


def _largest_nonlinearity(section: Section, periods: float) -> Nonlinearity:
    """Largest value of each number until the whole pulse has travelled a path of ``periods`` periods.

    On a long path, contacts still slip after the end of transmission.
    """
    looks = section.nonlinear[: 1 + int(periods / LOOKS_APART)]
    return Nonlinearity(*np.max(np.array(looks, dtype=float), axis=0).tolist()) if looks else Nonlinearity()


def shift_by_change(section: Section, reading: Reading) -> float:
    """Relative shift of the travel time per relative change of the signal.

    It is ``2 pi f w^2 / travel time``, see `estimate_error`. w^2 is the amplitude over the curvature of three smoothed
    values a sixteenth of the period apart. It is at most the squared period, and equal to it if they form no peak.
    """
    apart, index = max(1, int(section.period / 16)), reading.index
    period = 1.0 / section.frequency
    over_width = 2.0 * np.pi * section.frequency / reading.travel_time
    left, amplitude, right = (float(reading.clean[index + shift, -1]) for shift in (-apart, 0, apart))
    distance = apart * section.sampling_interval
    bend = (2.0 * amplitude - left - right) / (distance * distance)
    return float(over_width * (min(period * period, amplitude / bend) if bend > 0.0 else period * period))


def _error_parts(experiment: Experiment, section: Section, reading: Reading, shift: float) -> ErrorParts:
    """Bounds of the parts of the error of a velocity; ``shift`` is that of `shift_by_change`."""
    wave, frequency, travel_time = experiment.wave, section.frequency, reading.travel_time
    overlap = experiment.packing.report.mean_overlap
    step = 3.0 * (2.0 * np.pi * frequency) * section.time_step  # of the shortest waves of a pulse, rad
    # Changes of shape shift a peak by a part of the period, which matters more on a short path.
    periods = frequency * travel_time
    shape = max(1.0, 1.0 / periods)
    found = _largest_nonlinearity(section, periods)
    geometry = 0.0
    if wave.regime != "finite":
        stiffening = 3.0e-3 * wave.amplitude / frequency / overlap if wave.regime == "linear" else 0.0
        geometry = _turning_error(experiment) + stiffening
    geometry += 0.5 * section.closing_gaps
    geometry += 0.5 * float(found.rescaling)
    precision = 0.0
    if wave.precision == "float32":
        received = Pulse(wave.amplitude, frequency).stroke * float(reading.clean[reading.index, -1])
        rounding = 5.0 * float(np.finfo(np.float32).eps) / 2.0 * overlap / received
        precision = shape * 1.0e-3 + shift * rounding
    strong, coarse = wave.damping / (1.0 - wave.damping), section.time_step / section.stability_limit
    return ErrorParts(
        step=0.5 * section.time_step / (travel_time * (1.0 - wave.damping)) + step * step / 24.0,
        sampling=0.2 * section.sampling_interval / travel_time,  # largest value found: 0.13
        regime=shape * geometry,
        slip=float(min(1.0, shape * found.softening + _loss_error(section, shift, periods))),
        precision=precision,
        noise=ONSET / (np.pi * periods) if reading.roughness > ONSET else 0.0,
        chatter=1.8e-2 * (strong * strong * strong) * (coarse * coarse) * (coarse * coarse),
        unbalanced=20.0 * section.unbalanced_speed,
        breaking=shape * float(2.0 * np.sqrt(section.broken_bonds) / max(1, section.bonds)),
    )


def chatters(damping: float, contrast: float) -> bool:
    """Whether damping of contacts with such a stiffness contrast may change a signal far beyond the usual law.

    Its error must then be measured with another step. If ``(a / (1 - a))^3`` times the contrast of stiffness
    (`propagation.stiffness_contrast`) exceeds 500, velocities can be wrong without notice; below it, none was
    (docs/accuracy.md, "Scenes drawn at random"). The presets have 10 to 220.
    """
    strong = damping / (1.0 - damping)
    return strong * strong * strong * contrast > 500.0


def _turning_error(experiment: Experiment) -> float:
    """Relative error of a velocity by neglecting the rotation of loaded contacts, see `ErrorParts.regime`."""
    return 3.0 * experiment.packing.report.mean_overlap / float(np.mean(experiment.packing.radius))


def _loss_error(section: Section, shift: float, periods: float) -> float:
    """Bound of the relative error of a velocity from slipping contacts at the transmitter.

    From then on the part e of its force is missing. This moves a peak by ``shift`` e, like any change of the signal,
    and the peak of the pulse ``1 - cos 2 pi f t`` itself by ``e / (pi f)``.
    """
    return float(max(shift, 1.0 / (np.pi * periods)) * section.slipped)
