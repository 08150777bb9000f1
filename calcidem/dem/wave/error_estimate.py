"""Numerical error that a velocity has to state, from its record and settings alone: one to expect, and a bound.

The form of each part is derived where it stands. Its factor was measured against converged runs of the same cells;
docs/accuracy.md has these measurements, and a check on cells and packings that the factors had not seen.
"""

from typing import NamedTuple

import numpy as np

from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.main_peak import prepare_signals
from calcidem.dem.wave.pick import Signals
from calcidem.dem.wave.recorder import WaveRecord

_SAMPLING = 0.2  # over sampling interval / travel time; 0.13 was the largest found
_TURNING = 3.0  # over mean overlap / mean radius
_STIFFENING = 3.0e-3  # over stroke of the pulse / mean overlap
_CLOSING = 0.5  # over `WaveRecord.closing_gaps`
_SLIP = 0.8  # over the cube of `slip_ratio`
_SINGLE_PRECISION = 1.0e-3
_CHATTER = 7.5e-3  # see `_chatter_error`
_UNBALANCED = 20.0  # over `WaveRecord.unbalanced_speed`

_USUAL_STEP = 6.0e-5  # over step / limit
_USUAL_CHANGE = 1.7  # change of the signal near its peak over `WaveRecord.nonlinear_share`
_USUAL_ROUGHNESS = 0.25  # the same over what smoothing takes away
_USUAL = 0.1  # of the bound, for parts whose usual size has not been measured
_PART_OF_PERIOD = 16  # distance of the places that tell the width of a peak, as a part of the period


class ErrorParts(NamedTuple):
    """Bounds of the parts of the relative error of a velocity, which have nothing to do with one another.

    Attributes
    ----------
    step
        Local damping looks at velocities half a step old: an error of first order, ``dt / 2`` of the travel time
        (docs/accuracy.md, "Order of convergence in the step"). Leapfrog has ``sin(omega' dt / 2) = omega dt / 2``:
        it shifts frequencies by ``(omega dt)^2 / 24``. The shortest waves of a pulse have about 3 f.
    sampling
        The smoothing before the pick spans a whole number of samples, so a peak that is not symmetric moves by a part
        of an interval. The factor is half as large again as the largest shift found.
    regime
        See `_geometry_error` and `_slip_error`. Small and linear displacement also keep gaps open that a pulse closes:
        each adds a contact near the transmitter for half of the time (docs/accuracy.md, "Contacts that close").
    precision
        Rounding of single precision moves broad peaks (docs/accuracy.md, "Every knob").
    noise
        A pulse of height H falls off as ``H (1 - (pi f t)^2)`` from its peak. Noise n of the pulse's own frequency adds
        a slope of up to ``2 pi f n``, so the sum is highest at ``n / (pi f H)``. It counts where it hides the first
        arrival, so that n is at least the onset level: chattering contacts make it, and another step another one.
    chatter
        See `_chatter_error`.
    unbalanced
        Local damping works on the sum of all forces on a disk, and so sees what the packing left unbalanced, in
        proportion to its size over that of the wave (docs/accuracy.md, "Regime over the amplitude of the pulse").
    """

    step: float
    sampling: float
    regime: float
    precision: float
    noise: float
    chatter: float
    unbalanced: float


def error_bound(
    experiment: Experiment, record: WaveRecord, frequency: float, travel_time: float, *, noisy: bool = False
) -> float:
    """Bound of the relative error of a velocity: root of the sum of squares of its parts, see `ErrorParts`."""
    parts = error_parts(experiment, record, frequency, travel_time, noisy=noisy)
    return float(np.sqrt(sum(part * part for part in parts)))


_CURES = {
    "step": "make step_fraction smaller",
    "sampling": "make samples_per_period larger",
    "precision": "choose precision = 'float64'",
    "noise": "noise moves the peak; lower amplitude or the frequency",
    "chatter": "make step_fraction or damping smaller",
    "unbalanced": "raise amplitude, or make the packing's unbalanced_force_ratio smaller",
}


def largest_part(experiment: Experiment, parts: ErrorParts, most: float) -> str:
    """Name of the part of a bound that has to become smaller; ``most`` is what the bound may be."""
    if np.sqrt(np.sum(np.square(parts))) <= most:  # then the signal's shape makes it
        return "regime" if experiment.wave.regime == "linear" else "noise"
    return max(parts._fields, key=lambda name: getattr(parts, name))


def cure_of(experiment: Experiment, parts: ErrorParts, most: float) -> str:
    """What makes the largest part of a bound smaller; ``most`` is what the bound may be."""
    largest = largest_part(experiment, parts, most)
    if largest != "regime":
        return _CURES[largest]
    if turning_error(experiment) > most:
        return "the contacts overlap too far for a fixed geometry, at any amplitude; choose regime = 'finite'"
    return "lower amplitude, or choose regime = 'finite'"


def expected_error(
    experiment: Experiment,
    record: WaveRecord,
    signals: Signals,
    frequency: float,
    travel_time: float,
    *,
    noisy: bool = False,
) -> float:
    """Relative error to expect of a velocity: the order of its size, which ranks cells; Hz and s.

    A change of a signal by the part e of its height, as fast as the pulse is, tilts it by ``2 pi f e`` and so moves a
    peak ``H (1 - t^2 / (2 w^2))`` by ``2 pi f e w^2``. The change goes with `nonlinear_share` in the linear regime, and
    with how rough the signal is, since another step makes another chatter. To this come an error of first order in the
    step over its limit, and a part of what else the bound has.
    """
    parts = error_parts(experiment, record, frequency, travel_time, noisy=noisy)
    squared_width, roughness = _shape_of_peak(experiment, signals, travel_time)
    change = _USUAL_CHANGE * record.nonlinear_share + _USUAL_ROUGHNESS * roughness
    shift = 2.0 * np.pi * frequency * change * squared_width / travel_time
    others = parts.precision + parts.noise + parts.chatter + parts.unbalanced
    if experiment.wave.regime == "small":
        others += parts.regime
    step = _USUAL_STEP * record.time_step / record.stability_limit
    return float(step + shift + _USUAL * others)


def _shape_of_peak(experiment: Experiment, signals: Signals, travel_time: float) -> tuple[float, float]:
    """Height over curvature of the received signal where it was read, s^2, and rms of its roughness over that height.

    The curvature is that of three smoothed values a sixteenth of the sent period apart, and the result at most the
    square of that period; where they are not as a peak's, it is that square. Roughness is what smoothing takes away.
    """
    prepared = prepare_signals(signals, experiment.pick)
    interval = signals.sampling_interval
    top, apart = round(prepared.sent_peak + travel_time / interval), max(1, int(prepared.period / _PART_OF_PERIOD))
    widest = (prepared.period * interval) * (prepared.period * interval)
    if not apart <= top < len(prepared.smooth) - apart:
        return widest, 0.0
    left, height, right = (float(prepared.smooth[top + shift]) for shift in (-apart, 0, apart))
    bend = (2.0 * height - left - right) / (apart * interval) / (apart * interval)
    if height <= 0.0 or bend <= 0.0:
        return widest, 0.0
    end = top + int(prepared.period)
    return min(widest, height / bend), float(np.std(prepared.received[:end] - prepared.smooth[:end])) / height


def error_parts(
    experiment: Experiment, record: WaveRecord, frequency: float, travel_time: float, *, noisy: bool
) -> ErrorParts:
    """Bounds of the parts of the error of a velocity; ``noisy`` where noise hides the first arrival. Hz and s."""
    coarse = 3.0 * (2.0 * np.pi * frequency) * record.time_step
    # What changes the shape of the signal moves a peak by a part of the period, which weighs more on a short way.
    shape = max(1.0, 1.0 / (frequency * travel_time))
    geometry = _geometry_error(experiment, frequency) + _CLOSING * record.closing_gaps
    return ErrorParts(
        step=0.5 * record.time_step / travel_time + coarse * coarse / 24.0,
        sampling=_SAMPLING * record.sampling_interval / travel_time,
        regime=shape * geometry + _slip_error(experiment, frequency, travel_time),
        precision=shape * (_SINGLE_PRECISION if experiment.wave.precision == "float32" else 0.0),
        noise=experiment.pick.onset / (np.pi * frequency * travel_time) if noisy else 0.0,
        chatter=_chatter_error(experiment, record),
        unbalanced=_UNBALANCED * record.unbalanced_speed,
    )


def _chatter_error(experiment: Experiment, record: WaveRecord) -> float:
    """Estimated relative error of a velocity by local damping of the stiffest contacts.

    Local damping of factor a takes the part 1 - a or 1 + a of a force, by the sign of the velocity. Near the stability
    limit the velocities of the stiffest contacts turn over at almost every step, and how often they do decides what is
    left of the wave. In lattices the error rose about as the cube of ``a / (1 - a)`` and steeply with the step
    (docs/stability.md, "Drawn at random").
    """
    damping = experiment.wave.damping
    strong, coarse = damping / (1.0 - damping), record.time_step / record.stability_limit
    return float(_CHATTER * (strong * strong * strong) * (coarse * coarse) * (coarse * coarse))


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
    return turning_error(experiment) + (
        _STIFFENING * wave.amplitude / frequency / overlap if wave.regime == "linear" else 0.0
    )


def turning_error(experiment: Experiment) -> float:
    """First part of `_geometry_error`."""
    return _TURNING * experiment.packing.report.mean_overlap / float(np.mean(experiment.packing.radius))


def _slip_error(experiment: Experiment, frequency: float, travel_time: float) -> float:
    """Estimated relative error of a velocity by contacts that do not slip in the linear regime.

    The share of contacts so weakly pressed that they slip rises with about the square of `slip_ratio`, and what each of
    them does not pass on in proportion to it. The factor was set on the packing that slips most of four
    (docs/accuracy.md, "Error that each cell states").
    """
    if experiment.wave.regime != "linear":
        return 0.0
    ratio = slip_ratio(experiment, frequency, travel_time)
    return _SLIP * (ratio * ratio * ratio)


def slip_ratio(experiment: Experiment, frequency: float, travel_time: float) -> float:
    """Shear displacement of the contacts at the transmitter over that at which one of mean overlap slips.

    A contact there is a spring k_s that pulls at a medium of impedance ``rho V`` times the width d of a disk: of the
    stroke it takes ``x / sqrt(1 + x^2)`` with ``x = omega rho V d / k_s``. It slips at ``mu F_n / k_s``.
    """
    packing, sand, wave = experiment.packing, experiment.sand, experiment.wave
    radius, overlap = np.mean(packing.radius, keepdims=True), packing.report.mean_overlap
    hertz = experiment.stiffness_factor * float(sand.hertz_coefficient(radius)[0])
    shear = sand.shear_ratio * 1.5 * hertz * np.sqrt(overlap)
    impedance = sand.density * experiment.distance / travel_time * 2.0 * float(radius[0])
    x = 2.0 * np.pi * frequency * impedance / shear
    friction = min(sand.friction, wave.band_friction)
    taken = wave.amplitude / frequency * x / np.sqrt(1.0 + x * x)
    return float(taken / (friction * hertz * overlap * np.sqrt(overlap) / shear)) if friction > 0.0 else np.inf
