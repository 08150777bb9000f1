"""Numerical error that a velocity has to state, from its record and settings alone: one to expect, and a bound.

The form of each part is derived where it stands. Its factor was measured against converged runs of the same cells;
docs/accuracy.md has these measurements, and a check on cells and packings that the factors had not seen.
"""

from typing import NamedTuple

import numpy as np

from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.linearity import Nonlinearity
from calcidem.dem.wave.pulse import Pulse
from calcidem.dem.wave.reading import ONSET, ShearArrival
from calcidem.dem.wave.recorder import LOOKS_APART, WaveRecord
from calcidem.dem.wave.section import Section

_SAMPLING = 0.2  # over sampling interval / travel time; 0.13 was the largest found
_TURNING = 3.0  # over mean overlap / mean radius
_STIFFENING = 3.0e-3  # over stroke of the pulse / mean overlap
_RESCALING = 0.5  # over `linearity.Nonlinearity.rescaling`: a velocity goes with the root of the stiffness
_CLOSING = 0.5  # over `WaveRecord.closing_gaps`
_SINGLE_PRECISION = 1.0e-3
_ROUNDING = 5.0  # over the rounding of contact forces in single precision over the force of the received wave
_CHATTER = 1.8e-2  # see `_chatter_error`
_UNRULY = 500.0  # see `chatters`
_UNBALANCED = 20.0  # over `WaveRecord.unbalanced_speed`
_BREAKING = 2.0  # see `_breaking_error`

_USUAL_STEP = 7.5e-5  # over step / limit
_USUAL_CHANGE = 1.7  # change of the signal near its peak over the share of `linearity.Nonlinearity`
_USUAL_ROUGHNESS = 0.25  # the same over what smoothing removes
_USUAL_LOSS = 0.45  # of the bound of what the transmitter loses by slip, which moves a peak to one side alone
_USUAL = 0.1  # of the bound, for parts whose usual size has not been measured
_EACH_OF_TWO = 0.71  # of the difference of two runs, whose errors are as large as each other: 1 / sqrt(2)
_WORST_OF_HUNDRED = 4.6  # over the mean of an exponential distribution, as which errors were fitted: ln(100)
_PART_OF_PERIOD = 16  # distance of the places that tell the width of a peak, as a part of the period


class ErrorParts(NamedTuple):
    """Bounds of the parts of the relative error of a velocity, which have nothing to do with one another.

    Attributes
    ----------
    step
        Local damping a looks at velocities half a step old: an error of first order, ``dt / 2`` of the travel time
        (docs/accuracy.md, "Order of convergence in the step"), and more by 1 / (1 - a), to which it slows a wave that
        loads contacts (benchmarks/accuracy/drawn.py). Leapfrog has ``sin(omega' dt / 2) = omega dt / 2``:
        it shifts frequencies by ``(omega dt)^2 / 24``. The shortest waves of a pulse have about 3 f.
    sampling
        The smoothing before the pick spans a whole number of samples, so a peak that is not symmetric moves by a part
        of an interval. The factor is half as large again as the largest shift found.
    regime
        See `_geometry_error`, and `linearity.Nonlinearity.rescaling`. Small and linear displacement also keep gaps open
        that a pulse closes: each adds a contact near the transmitter for half of the time (docs/accuracy.md,
        "Amplitude of the pulse").
    slip
        See `_slip_error`.
    precision
        Rounding of single precision moves broad peaks (docs/accuracy.md, "Every setting"). It also adds the part
        2^-24 of the forces that the packing carries, which go with its overlap, to those of the wave, which go with
        the stroke of the pulse and the part of its amplitude that is received.
    noise
        A pulse of amplitude H falls off as ``H (1 - (pi f t)^2)`` from its peak. Noise n of the pulse's own frequency
        adds a slope of up to ``2 pi f n``, so the sum is highest at ``n / (pi f H)``. It counts where it hides the
        first arrival, so that n is at least the onset level: chattering contacts make it, and another step another one.
    chatter
        See `_chatter_error`.
    unbalanced
        Local damping works on the sum of all forces on a disk, and so sees what the packing left unbalanced, in
        proportion to its size over that of the wave (docs/accuracy.md, "Amplitude of the pulse").
    breaking
        See `_breaking_error`.
    """

    step: float
    sampling: float
    regime: float
    slip: float
    precision: float
    noise: float
    chatter: float
    unbalanced: float
    breaking: float


def error_bound(parts: ErrorParts) -> float:
    """Bound of the relative error of a velocity: root of the sum of squares of its parts."""
    return float(np.sqrt(sum(part * part for part in parts)))


_CURES = {
    "step": "make step_fraction smaller",
    "sampling": "make samples_per_period larger",
    "slip": "contacts slip that the linear regime holds; choose regime = 'finite', or a lower amplitude",
    "precision": "choose precision = 'float64'",
    "noise": "noise moves the peak; lower amplitude or the frequency",
    "chatter": "make step_fraction or damping smaller",
    "unbalanced": "raise amplitude, or make the packing's unbalanced_force_ratio smaller",
    "breaking": "bonds break, and which of them is chance; lower amplitude",
}


def _largest_part(experiment: Experiment, parts: ErrorParts, most: float) -> str:
    """Name of the part of a bound that has to become smaller; ``most`` is what the bound may be."""
    if error_bound(parts) <= most:  # then the signal's shape makes it
        return "regime" if experiment.wave.regime == "linear" else "noise"
    return max(parts._fields, key=lambda name: getattr(parts, name))


def cure_of(experiment: Experiment, parts: ErrorParts, most: float) -> str:
    """What makes the largest part of a bound smaller; ``most`` is what the bound may be."""
    largest = _largest_part(experiment, parts, most)
    if largest != "regime":
        return _CURES[largest]
    if _turning_error(experiment) > most:
        return "the contacts overlap too far for a fixed geometry, at any amplitude; choose regime = 'finite'"
    return "lower amplitude, or choose regime = 'finite'"


class NumericalError(NamedTuple):
    """Relative numerical error of a velocity.

    Attributes
    ----------
    expected
        Order of its size, which ranks cells.
    bound
        Its bound.
    parts
        Bounds of its parts.
    """

    expected: float
    bound: float
    parts: ErrorParts


def estimate_error(
    experiment: Experiment, record: WaveRecord, arrival: ShearArrival, chatter: float | None = None
) -> NumericalError:
    """Relative numerical error of a velocity that was read.

    ``chatter`` is its relative change by half of the step, where that was measured.

    What is expected is the order of its size. A change of a signal by the part e of its amplitude, as fast as the pulse
    is, tilts it by ``2 pi f e`` and so moves a peak ``H (1 - t^2 / (2 w^2))`` by ``2 pi f e w^2``. The change goes with
    the nonlinear share in the linear regime, and with how rough the signal is: another step makes another chatter. To
    this come an error of first order in the step over its limit, and a part of what else the bound has. The bound is
    no less than what one of a hundred such errors exceeds; what the transmitter loses has its own.
    """
    frequency, travel_time = record.section.frequency, arrival.travel_time
    shift = _shift_by_change(record.section, arrival)
    parts = _error_parts(experiment, record, arrival, shift)
    weight = 1.0
    if chatter is not None:
        parts, weight = parts._replace(chatter=chatter), _EACH_OF_TWO / _USUAL
    share = _largest_nonlinearity(record, frequency * travel_time).share
    change = _USUAL_CHANGE * share + _USUAL_ROUGHNESS * arrival.roughness
    others = parts.precision + parts.noise + weight * parts.chatter + parts.unbalanced + parts.breaking
    if experiment.wave.regime == "small":
        others += parts.regime
    step = _USUAL_STEP * record.time_step / record.stability_limit
    usual = float(step + shift * change + _USUAL * others)
    loss = _USUAL_LOSS * _loss_error(record, shift, frequency * travel_time)
    return NumericalError(usual + loss, max(error_bound(parts), _WORST_OF_HUNDRED * usual), parts)


def _largest_nonlinearity(record: WaveRecord, periods: float) -> Nonlinearity:
    """Largest of each number until the whole pulse had travelled a path of so many periods.

    On a long path contacts slip that the pulse had not reached when its transmission ended.
    """
    looks = record.nonlinear[: 1 + int(periods / LOOKS_APART)]
    return Nonlinearity(*np.max(np.array(looks, dtype=float), axis=0).tolist()) if looks else Nonlinearity()


def _shift_by_change(section: Section, arrival: ShearArrival) -> float:
    """Shift of the peak over the travel time by a change of the signal, over that change.

    It is ``2 pi f w^2 / travel time``, see `estimate_error`; w^2 is amplitude over curvature of three smoothed values a
    sixteenth of the period apart, and at most the square of that period; where they are not as a peak's, it is that.
    """
    apart, index = max(1, int(section.period / _PART_OF_PERIOD)), arrival.index
    period = 1.0 / section.frequency
    over_width = 2.0 * np.pi * section.frequency / arrival.travel_time
    left, amplitude, right = (float(arrival.clean[index + shift, -1]) for shift in (-apart, 0, apart))
    distance = apart * section.sampling_interval
    bend = (2.0 * amplitude - left - right) / (distance * distance)
    return float(over_width * (min(period * period, amplitude / bend) if bend > 0.0 else period * period))


def _error_parts(experiment: Experiment, record: WaveRecord, arrival: ShearArrival, shift: float) -> ErrorParts:
    """Bounds of the parts of the error of a velocity; ``shift`` is that of `_shift_by_change`."""
    frequency, travel_time = record.section.frequency, arrival.travel_time
    coarse = 3.0 * (2.0 * np.pi * frequency) * record.time_step
    # What changes the shape of the signal moves a peak by a part of the period, which weighs more on a short path.
    periods = frequency * travel_time
    shape = max(1.0, 1.0 / periods)
    found = _largest_nonlinearity(record, periods)
    single = experiment.wave.precision == "float32"
    geometry = _geometry_error(experiment, frequency) + _CLOSING * record.closing_gaps
    geometry += _RESCALING * float(found.rescaling)
    return ErrorParts(
        step=0.5 * record.time_step / (travel_time * (1.0 - experiment.wave.damping)) + coarse * coarse / 24.0,
        sampling=_SAMPLING * record.section.sampling_interval / travel_time,
        regime=shape * geometry,
        slip=_slip_error(record, shift, periods),
        precision=shape * _SINGLE_PRECISION + shift * _rounding(experiment, frequency, arrival) if single else 0.0,
        noise=ONSET / (np.pi * periods) if arrival.roughness > ONSET else 0.0,
        chatter=_chatter_error(experiment, record),
        unbalanced=_UNBALANCED * record.unbalanced_speed,
        breaking=shape * _breaking_error(record),
    )


def _rounding(experiment: Experiment, frequency: float, arrival: ShearArrival) -> float:
    """Change of the received signal by the rounding of contact forces in single precision, over its amplitude."""
    stroke = Pulse(experiment.wave.amplitude, frequency).stroke * float(arrival.clean[arrival.index, -1])
    return _ROUNDING * float(np.finfo(np.float32).eps) / 2.0 * experiment.packing.report.mean_overlap / stroke


def _chatter_error(experiment: Experiment, record: WaveRecord) -> float:
    """Estimated relative error of a velocity by local damping of the stiffest contacts.

    Local damping of factor a takes the part 1 - a or 1 + a of a force, by the sign of the velocity. Near the stability
    limit the velocities of the stiffest contacts turn over at almost every step, and how often they do decides what is
    left of the wave. In lattices the error rose about as the cube of ``a / (1 - a)`` and steeply with the step
    (docs/stability.md, "Drawn at random"), where nothing `chatters`.
    """
    damping = experiment.wave.damping
    strong, coarse = damping / (1.0 - damping), record.time_step / record.stability_limit
    return float(_CHATTER * (strong * strong * strong) * (coarse * coarse) * (coarse * coarse))


def chatters(damping: float, contrast: float) -> bool:
    """Whether local damping of contacts so much stiffer than others may change a signal far more than by its law.

    Then its error has to be measured with another step: where ``(a / (1 - a))^3`` times the contrast of stiffness
    (`propagation.stiffness_contrast`) was above 500, velocities were wrong in silence, below it none was
    (docs/accuracy.md, "Scenes drawn at random"). The presets have 10 to 220.
    """
    strong = damping / (1.0 - damping)
    return strong * strong * strong * contrast > _UNRULY


def _breaking_error(record: WaveRecord) -> float:
    """Estimated relative error of a velocity by bonds so near their strength that another step breaks others.

    Where n break of N, some ``sqrt(n)`` more or fewer would, as counts of rare events scatter. The stiffness of a bond
    is at most 1 / N of what bonds carry, but those that break are near the transmitter, where each counts for more
    (docs/accuracy.md, "The error to expect").
    """
    return float(_BREAKING * np.sqrt(record.broken_bonds) / max(1, record.bonds))


def _geometry_error(experiment: Experiment, frequency: float) -> float:
    """Estimated relative error of a velocity by geometry and stiffnesses that a regime takes for constant.

    - A loaded contact that turns by ``u / (2 R)`` pushes sideways with ``F_n / (2 R)`` per displacement u. For Hertz,
      ``F_n = (2/3) k_n d``, that is ``d / (3 R)`` of its stiffness at overlap d. A fixed geometry has none of it.
    - Constant stiffnesses also miss what the stroke of the pulse changes: ``k_n`` goes with the root of the overlap.
    """
    wave, packing = experiment.wave, experiment.packing
    if wave.regime == "finite":
        return 0.0
    overlap = packing.report.mean_overlap
    return _turning_error(experiment) + (
        _STIFFENING * wave.amplitude / frequency / overlap if wave.regime == "linear" else 0.0
    )


def _turning_error(experiment: Experiment) -> float:
    """First part of `_geometry_error`."""
    return _TURNING * experiment.packing.report.mean_overlap / float(np.mean(experiment.packing.radius))


def _slip_error(record: WaveRecord, shift: float, periods: float) -> float:
    """Bound of the relative error of a velocity by contacts that do not slip in the linear regime; 1 says nothing.

    - A velocity goes with the root of the stiffness, of which slip takes `linearity.Nonlinearity.softening` away: half
      of it, were what it takes from each contact's neighbours the same everywhere. Twice that here
      (docs/stability.md, "near isostaticity"); on a path of less than a wavelength that changes the shape, as in
      `_error_parts`. ``periods`` are f travel time.
    - What the transmitter loses: see `_loss_error`.

    Contacts slip where the pulse over what they have left to their friction limit is large, or nothing is left.
    """
    found = _largest_nonlinearity(record, periods)
    loss = _loss_error(record, shift, periods)
    return float(min(1.0, max(1.0, 1.0 / periods) * found.softening + loss))


def _loss_error(record: WaveRecord, shift: float, periods: float) -> float:
    """Bound of the relative error of a velocity where contacts at the transmitter slip.

    The part e of its force is missing from then on. That moves a peak as changes of the signal do, by ``shift`` e, and
    the peak of the pulse ``1 - cos 2 pi f t`` itself by ``e / (pi f)``.
    """
    return float(max(shift, 1.0 / (np.pi * periods)) * record.slipped)
