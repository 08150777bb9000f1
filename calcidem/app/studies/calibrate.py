"""Fitting what the paper leaves open to measured means and scatter of Vs: named parameters, common random numbers."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.parameters import ParameterRange, check_ranges, start_value, with_values
from calcidem.app.studies.targets import Target
from calcidem.app.studies.trials import check_cells, trial_workers
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.packing import Packing

FITTED_BY_DEFAULT = ("sand.wave_stiffness_factor", "pattern.p_share", "pattern.cluster_area")
"""Parameters that are fitted if none are named, as far as there are targets."""

_STEP = 0.06
"""Relative step of the derivatives: whole contacts and clusters come and go, so Vs is no smooth function."""

_CONVERGED = 0.01
"""Relative change of the parameters that is not worth another round; their statistical error is larger."""

_LARGEST_CHANGE = math.log(2.0)
"""Largest change of a logarithm in one round."""

_MOST_ROUNDS = 6
"""From a start within a factor of two, three are enough."""

_MOST_HALVINGS = 3

ParameterValues = Mapping[str, float]
"""Value of each parameter by its name."""

_FEWEST_SEEDS = 3
"""Below it a standard deviation says nothing."""


@dataclass(frozen=True, slots=True)
class FitPlan:
    """What is fitted to what.

    Attributes
    ----------
    targets
        What to meet; those at a content of ``predict`` are only compared.
    free
        Parameters to fit, at most as many as numbers to meet.
    seeds
        The same in every trial, so that trials differ by the parameters alone; a seed counts at a content only if it is
        read in every one of them.
    predict
        Further contents to measure with the fitted values, percent.
    tolerance
        Relative deviation that the model may have by itself, added to the sampling error of every target.
    """

    targets: Sequence[Target]
    free: Sequence[ParameterRange]
    seeds: Sequence[int]
    predict: Sequence[float] = ()
    tolerance: float = 0.02

    @property
    def met(self) -> tuple[Target, ...]:
        """Targets of the fit."""
        return tuple(target for target in self.targets if target.content not in self.predict)


@dataclass(frozen=True, slots=True)
class FittedContent:
    """A content of a calibration.

    Attributes
    ----------
    content
        Percent.
    target
        What was wanted there, None if nothing was.
    fitted
        Whether it took part in the fit; otherwise it is a prediction.
    seeds, planned
        Seeds that are read in every trial, or with the fitted values for a prediction; and all that were measured.
    mean, mean_error, sd
        Of Vs over these seeds with the fitted values, the standard error of the mean, and the standard deviation, m/s.
    """

    content: float
    target: Target | None
    fitted: bool
    seeds: int
    planned: int
    mean: float
    mean_error: float
    sd: float


@dataclass(frozen=True, slots=True, eq=False)
class FittedParameters:
    """Parameters that a fit found.

    Attributes
    ----------
    values
        Fitted value of each parameter, in SI units.
    deviations
        Standard deviation of each, by the scatter of Vs between seeds and between the samples of the targets.
    correlation
        (P, P) of the parameters.
    at_limit
        Parameters that ended at a limit of their range, so that their deviation says little.
    contents
        Targets and what was reached, then predictions.
    trials
        Number of points at which Vs was measured.
    chi_square, freedom
        Sum of the squares that are left, each over that of its error, and how many numbers to meet there are more than
        parameters: far above that, the model cannot meet the targets, and the deviations are too small.
    """

    values: ParameterValues
    deviations: ParameterValues
    correlation: Floats
    at_limit: tuple[str, ...]
    contents: tuple[FittedContent, ...]
    trials: int
    chi_square: float
    freedom: int


class UnreadableTrialError(ValueError):
    """Too few seeds have a velocity in every trial; says at which content and how many."""


class _Fit:
    """Trials of a fit, and the deviations from the targets on the seeds that all of them read.

    Parameters
    ----------
    targets
        One for each column of what ``measure`` gives.
    tolerance
        Relative deviation of the model that counts as an error of every target.
    """

    def __init__(
        self, measure: Callable[[Sequence[Floats]], Sequence[Floats]], targets: Sequence[Target], tolerance: float
    ) -> None:
        self._measure, self._targets, self._tolerance = measure, targets, tolerance
        self.trials: dict[bytes, Floats] = {}

    def try_points(self, points: Sequence[Floats]) -> None:
        """Measure points (logarithms of values) that are not known yet; half of the seeds have to be left by all.

        Raises
        ------
        UnreadableTrialError
            If they are not; then none of the points counts.
        """
        new = [point for point in points if point.tobytes() not in self.trials]
        former = dict(self.trials)
        if new:
            self.trials |= {point.tobytes(): vs for point, vs in zip(new, self._measure(new), strict=True)}
        left, planned = self.common.sum(axis=0), len(self.common)
        if (left < max(_FEWEST_SEEDS, planned / 2)).any():
            self.trials = former
            content = self._targets[int(np.argmin(left))].content
            raise UnreadableTrialError(
                f"content = {content:g} %: only {left.min()} of {planned} seeds have a velocity in every trial; "
                "begin with values whose waves are read, narrow the ranges or leave the content out"
            )

    @property
    def common(self) -> NDArray[np.bool_]:
        """Which seeds count at each content, (seeds, contents): those that have a velocity in every trial."""
        return np.asarray(np.isfinite(list(self.trials.values())).all(axis=0))

    def deviation(self, point: Floats) -> Floats:
        """Logarithms of mean, and of standard deviation where there is a target, over their targets, (R,)."""
        found = []
        for target, vs in self._columns(point):
            found.append(math.log(vs.mean() / target.vs))
            if target.sd is not None:
                found.append(math.log(vs.std(ddof=1) / target.sd))
        return np.array(found)

    def errors(self, point: Floats) -> Floats:
        """Standard errors of `deviation` for normal scatter, (R,): of target and trial, and the model's tolerance."""
        found = []
        for target, vs in self._columns(point):
            scatter = max((target.sd or vs.std(ddof=1)) / target.vs, 1e-6)
            of_target = 0.0 if target.samples is None else 1.0
            count = target.samples or 2
            found.append(math.hypot(self._tolerance, scatter * math.sqrt(1.0 / len(vs) + of_target / count)))
            if target.sd is not None:
                half = 0.5 / (len(vs) - 1) + 0.5 * of_target / (count - 1)
                found.append(math.hypot(self._tolerance, math.sqrt(half)))
        return np.array(found)

    def covariance(self, point: Floats) -> Floats:
        """Covariance of `deviation` by sampling, (R, R).

        Of the trial by the influence of each seed, which is at work at all contents, so that neither normal scatter nor
        independent contents are assumed (Efron & Tibshirani 1993, chapter 21); of the targets for normal scatter.
        """
        influence, of_targets = [], []
        for target, used, vs in zip(self._targets, self.common.T, self.trials[point.tobytes()].T, strict=True):
            count, mean = used.sum(), vs[used].mean()
            from_mean = np.where(used, vs - mean, 0.0)
            scatter = max((target.sd or vs[used].std(ddof=1)) / target.vs, 1e-6)
            influence.append(from_mean / mean / math.sqrt(count * (count - 1)))
            of_targets.append(0.0 if target.samples is None else scatter**2 / target.samples)
            if target.sd is not None:
                variance = vs[used].var()
                of_deviation = np.where(used, from_mean**2 - variance, 0.0) / (2.0 * variance)
                influence.append(of_deviation / math.sqrt(count * (count - 1)))
                of_targets.append(0.0 if target.samples is None else 0.5 / (target.samples - 1))
        rows = np.array(influence)
        return np.asarray(rows @ rows.T + np.diag(of_targets))

    def _columns(self, point: Floats) -> list[tuple[Target, Floats]]:
        """Each target with the velocities that count there."""
        vs, common = self.trials[point.tobytes()], self.common
        return [(target, vs[common[:, i], i]) for i, target in enumerate(self._targets)]


def calibrate(
    configuration: Configuration,
    packing: Packing,
    plan: FitPlan,
    cores: int = 1,
    tell: Callable[[str], None] = lambda _: None,
) -> FittedParameters:
    """Fit parameters to means, and standard deviations, of Vs by weighted least squares of their logarithms.

    Parameters
    ----------
    configuration
        Where to begin.
    packing
        Of the campaign.
    plan
        What is fitted to what.
    cores
        Batches of seeds that are computed at a time.
    tell
        Told of every trial.

    Raises
    ------
    ConfigurationError
        If a parameter cannot be fitted, or there are more parameters than numbers to meet.
    UnreadableTrialError
        If too few seeds are read at the start or near it.

    Notes
    -----
    Gauss-Newton on the logarithms of the parameters, within their ranges, with one-sided differences; a step that does
    not come nearer is halved.
    """
    check_ranges(configuration, plan.free, "calibration")
    check_cells(configuration, packing, sorted({row.content for row in plan.targets} | set(plan.predict)), plan.seeds)
    start = [start_value(configuration, packing, chosen) for chosen in plan.free]

    def changed(tried: Sequence[ParameterValues]) -> list[Configuration]:
        return [with_values(configuration, values) for values in tried]

    contents = [target.content for target in plan.met]
    with trial_workers(packing, contents, plan.seeds, cores) as measure_trials:
        fitted = _fit_to_targets(lambda tried: list(measure_trials(changed(tried))), plan, start, tell)
    if not plan.predict:
        return fitted
    known = {target.content: target for target in plan.targets}
    with trial_workers(packing, plan.predict, plan.seeds, cores) as measure_trials:
        (found,) = measure_trials(changed([fitted.values]))
    predictions = (
        _summary(content, known.get(content), vs, np.isfinite(vs), fitted=False)
        for content, vs in zip(plan.predict, found.T, strict=True)
    )
    return replace(fitted, contents=(*fitted.contents, *predictions))


def _fit_to_targets(
    measure: Callable[[Sequence[ParameterValues]], Sequence[Floats]],
    plan: FitPlan,
    start: Sequence[float],
    tell: Callable[[str], None] = lambda _: None,
) -> FittedParameters:
    """Fit as `calibrate` does, whatever gives the velocities.

    Parameters
    ----------
    measure
        Takes values of the parameters, gives Vs for each, (seeds, contents of the targets), NaN where there is none.
    plan, tell
        See `calibrate`; the predictions are the caller's.
    start
        Value of each parameter to begin with, positive.

    Raises
    ------
    ConfigurationError, UnreadableTrialError
        As `calibrate`.
    """
    names, wanted = [chosen.name for chosen in plan.free], sum(1 if row.sd is None else 2 for row in plan.met)
    problems = []
    if len(names) > wanted:
        problem = f"parameters = {len(names)}: give at most {wanted}, one for each mean and standard deviation"
        problems.append(Problem(problem))
    if not 0.0 <= plan.tolerance < math.inf:
        problems.append(Problem(f"tolerance = {plan.tolerance}: give a number of 0 or more, such as 0.02"))
    if problems:
        raise ConfigurationError("calibration", problems)
    with np.errstate(divide="ignore"):  # without a lower limit it is 0, whose logarithm is minus infinity
        limits = np.log([[chosen.low, chosen.high] for chosen in plan.free])
    fit = _Fit(lambda points: measure([_values_at(names, point) for point in points]), plan.met, plan.tolerance)
    point, slopes = _descend(fit, np.log(start), limits, names, tell)
    errors = fit.errors(point)
    inverse = np.linalg.pinv(slopes / errors[:, None]) / errors
    covariance = inverse @ fit.covariance(point) @ inverse.T
    deviation = np.sqrt(np.diag(covariance))
    at_limit = np.isclose(point[:, None], limits, atol=1e-6).any(axis=1)
    columns = zip(plan.met, fit.trials[point.tobytes()].T, fit.common.T, strict=True)
    return FittedParameters(
        values=_values_at(names, point),
        deviations=_values_at(names, point + np.log(deviation)),
        correlation=covariance / np.outer(deviation, deviation),
        at_limit=tuple(names[i] for i in np.flatnonzero(at_limit)),
        contents=tuple(_summary(target.content, target, vs, used, fitted=True) for target, vs, used in columns),
        trials=len(fit.trials),
        chi_square=float(np.sum((fit.deviation(point) / errors) ** 2)),
        freedom=wanted - len(names),
    )


def _values_at(names: Sequence[str], point: Floats) -> dict[str, float]:
    """Values by name, from their logarithms."""
    return dict(zip(names, np.exp(point).tolist(), strict=True))


def _descend(
    fit: _Fit, start: Floats, limits: Floats, names: Sequence[str], tell: Callable[[str], None]
) -> tuple[Floats, Floats]:
    """Point at which the weighted squares are least, and the slopes (R, P) of the last round."""
    point, slopes = start, np.empty((0, 0))
    for _ in range(_MOST_ROUNDS):
        steps = np.where(point + _STEP > limits[:, 1], -_STEP, _STEP)
        beside = [point + step * unit for step, unit in zip(steps, np.eye(len(point)), strict=True)]
        try:
            fit.try_points([point, *beside])
        except UnreadableTrialError as error:
            if not slopes.size:
                raise
            tell(f"Ended before it converged: {error}")
            break
        own, errors = fit.deviation(point), fit.errors(point)
        tell(_told(names, point, own, errors))
        slopes = np.array([(fit.deviation(other) - own) / step for other, step in zip(beside, steps, strict=True)]).T
        for name, column in zip(names, slopes.T, strict=True):
            if not column.any():
                problem = f"{name}: changes no Vs at these contents; leave it out"
                raise ConfigurationError("calibration", [Problem(problem)])
        low, high = np.maximum(limits.T[0] - point, -_LARGEST_CHANGE), np.minimum(limits.T[1] - point, _LARGEST_CHANGE)
        step = lsq_linear(slopes / errors[:, None], -own / errors, bounds=(low - 1e-9, high + 1e-9)).x.clip(low, high)
        nearer = _nearer(fit, point, step, errors)
        if nearer is None:
            break
        converged = np.abs(nearer - point).max() < _CONVERGED
        point = nearer
        if converged:
            break
    tell(_told(names, point, fit.deviation(point), fit.errors(point)))
    return point, slopes


def _nearer(fit: _Fit, point: Floats, step: Floats, errors: Floats) -> Floats | None:
    """First of the step, its half, its quarter and so on that comes nearer to the targets; None if none does."""
    for halvings in range(_MOST_HALVINGS + 1):
        other = np.asarray(point + step / 2**halvings)
        try:
            fit.try_points([other])
        except UnreadableTrialError:
            continue
        squares = [float(np.sum((fit.deviation(tried) / errors) ** 2)) for tried in (other, point)]
        if squares[0] < squares[1]:
            return other
    return None


def _told(names: Sequence[str], point: Floats, deviation: Floats, errors: Floats) -> str:
    """What is told of a point."""
    shown = ", ".join(f"{name} {value:.4g}" for name, value in _values_at(names, point).items())
    ratios = ", ".join(f"{ratio:.3f}" for ratio in np.exp(deviation))
    return f"{shown}: over target {ratios}; chi-square {np.sum((deviation / errors) ** 2):.2f}"


def _summary(
    content: float, target: Target | None, vs: Floats, used: NDArray[np.bool_], *, fitted: bool
) -> FittedContent:
    """Row of the result for the velocities of one content and those among them that count."""
    count, chosen = int(used.sum()), vs[used]
    mean = float(chosen.mean()) if count else math.nan
    sd = float(chosen.std(ddof=1)) if count > 1 else math.nan
    return FittedContent(content, target, fitted, count, len(vs), mean, sd / math.sqrt(max(count, 1)), sd)
