"""Calibration of named parameters on measured means and scatter of Vs, with common random numbers and posterior."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import lsq_linear

from calcidem.analysis.measured import Target
from calcidem.app.config.checks import check_against_packing, cross_check
from calcidem.app.config.reader import change_configuration
from calcidem.app.config.schema import Configuration, ConfigurationError, Problem
from calcidem.app.studies.study import ParameterRange, point_of_study, point_velocities
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.packing import Packing

FITTED_BY_DEFAULT = ("sand.wave_stiffness_factor", "pattern.p_share", "pattern.cluster_area")
"""Parameters fitted by default, as many as there are targets."""

ParameterValues = Mapping[str, float]
"""Value of each parameter by its name."""

_FEWEST_SEEDS = 3
"""Fewest seeds with a velocity for a meaningful mean and standard deviation; contents with fewer are left out."""


@dataclass(frozen=True, slots=True)
class FitPlan:
    """Parameters and targets of a fit."""

    targets: Sequence[Target]
    """Targets of the fit; those at a content of ``predict`` are only compared."""
    free: Sequence[ParameterRange]
    """Parameters to fit, at most as many as numbers to meet."""
    seeds: Sequence[int]
    """Seeds common to all trials, so that trials differ only in the parameters. A seed counts at a content only if it
    has a velocity in every trial.
    """
    predict: Sequence[float] = ()
    """Further contents to measure with the fitted values, percent."""
    tolerance: float = 0.02
    """Relative error of the model itself, added to the sampling error of every target."""

    def start(self, configuration: Configuration, packing: Packing) -> dict[str, float]:
        """Value of each parameter at the start; `ConfigurationError` with the problems of all that cannot be fitted."""
        names = [chosen.name for chosen in self.free]
        problems = [problem for chosen in self.free for problem in chosen.problems(configuration)]
        problems += [Problem(f"{name}: is named twice; remove one") for name in set(names) if names.count(name) > 1]
        if not names:
            problems.append(Problem("parameters = 0: name at least one, such as cement.bond_modulus"))
        if problems:
            raise ConfigurationError("calibration", problems)
        try:
            return {chosen.name: chosen.start_value(configuration, packing) for chosen in self.free}
        except ValueError as error:
            raise ConfigurationError("calibration", [Problem(str(error))]) from error

    @property
    def met(self) -> tuple[Target, ...]:
        """Targets of the fit."""
        return tuple(target for target in self.targets if target.content not in self.predict)

    @property
    def goals(self) -> "tuple[_Goal, ...]":
        """What they ask for; without cement no standard deviation, as all samples of a campaign are one."""
        return tuple(
            _Goal(place, target, name)
            for place, target in enumerate(self.met)
            for name in (("mean", "sd") if target.sd is not None and target.content != 0.0 else ("mean",))
        )


@dataclass(frozen=True, slots=True)
class FittedContent:
    """A content of a calibration."""

    content: float
    """Percent."""
    target: Target | None
    """Target there, or None."""
    role: Literal["fitted", "left out", "predicted"]
    """``fitted``, ``left out`` with too few readable seeds, or ``predicted``."""
    seeds: int
    planned: int
    """Seeds with a velocity in every trial, or in a prediction with the fitted values, and all measured seeds."""
    mean: float
    mean_error: float
    sd: float
    """Mean of Vs over these seeds with the fitted values, its standard error, and the standard deviation, m/s."""
    mean_band: tuple[float, float] | None = None
    sd_band: tuple[float, float] | None = None
    """95 % bands of mean and standard deviation, m/s, of campaigns with as many samples as the target, for parameters
    drawn from their posterior; None if unknown.
    """


@dataclass(frozen=True, slots=True, eq=False)
class FittedParameters:
    """Fitted parameters."""

    values: ParameterValues
    """Fitted value of each parameter, in SI units."""
    deviations: ParameterValues
    """Standard deviation of each parameter from the scatter of Vs between seeds and between samples of the targets."""
    correlation: Floats
    """(P, P) correlation of the parameters."""
    at_limit: tuple[str, ...]
    """Parameters that ended at a limit of their range; their deviations mean little."""
    contents: tuple[FittedContent, ...]
    """Targets with the results reached, then predictions."""
    trials: int
    """Number of points at which Vs was measured."""
    chi_square: float
    freedom: int
    """Sum of squared residuals over squared errors, and degrees of freedom: targets minus parameters. If chi-square is
    far above the latter, the model cannot meet the targets, and the deviations are too small.
    """
    doubts: tuple[str, ...] = ()
    """Objections to the result, a sentence each."""
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Bounds of the 95 % posterior interval of each (`calcidem.app.studies.calibrate`), if the trials determine it."""

    @property
    def is_fitted(self) -> bool:
        """Whether any parameter was fitted; otherwise the values are those of the start."""
        return any(row.role == "fitted" for row in self.contents)


@dataclass(frozen=True, slots=True)
class _Goal:
    """Mean or standard deviation of Vs to be met at one content."""

    place: int
    """Column of the content in the result of a trial."""
    target: Target
    name: Literal["mean", "sd"]

    @property
    def value(self) -> float:
        """Value to be met, m/s."""
        return self.target.vs if self.name == "mean" else self.target.sd or math.nan

    def of(self, vs: Floats) -> float:
        """The same of some velocities."""
        return float(vs.mean() if self.name == "mean" else vs.std(ddof=1))

    def variance(self, vs: Floats, samples: int) -> float:
        """Variance of its logarithm over samples with normal scatter, as the target's or that of some velocities."""
        scatter = max((self.target.sd or vs.std(ddof=1)) / self.target.vs, 1e-6)
        return scatter**2 / samples if self.name == "mean" else 0.5 / (samples - 1)

    def variance_of_target(self, vs: Floats) -> float:
        """Variance of the logarithm of its value."""
        return 0.0 if self.target.samples is None else self.variance(vs, self.target.samples)


class _UnreadTrialError(ValueError):
    """A trial would leave too few seeds."""


class _Fit:
    """Trials of a fit, and deviations from the targets over the seeds with a velocity in all trials.

    The result of ``measure`` has a column for each target of the plan.
    """

    def __init__(self, measure: Callable[[Sequence[Floats]], Sequence[Floats]], plan: FitPlan) -> None:
        self._measure, self._goals, self.tolerance = measure, plan.goals, plan.tolerance
        self.trials: dict[bytes, Floats] = {}
        self.used: tuple[int, ...] = tuple(range(len(plan.met)))

    @property
    def goals(self) -> tuple[_Goal, ...]:
        """Means and standard deviations to be met at the used contents."""
        return tuple(goal for goal in self._goals if goal.place in self.used)

    def begin(self, points: Sequence[Floats]) -> None:
        """Measure the first points, and leave out contents with too few readable seeds."""
        self.trials = {point.tobytes(): vs for point, vs in zip(points, self._measure(points), strict=True)}
        self.used = tuple(np.flatnonzero(self.common.sum(axis=0) >= _FEWEST_SEEDS).tolist())

    def try_points(self, points: Sequence[Floats]) -> None:
        """Measure new points (logarithms of values).

        `_UnreadTrialError` if a used content has too few seeds or no scatter to fit; then none of the points counts.
        """
        new = [point for point in points if point.tobytes() not in self.trials]
        former = dict(self.trials)
        if new:
            self.trials |= {point.tobytes(): vs for point, vs in zip(new, self._measure(new), strict=True)}
        common = self.common
        for goal in self.goals:
            left = int(common[:, goal.place].sum())
            words = "" if left >= _FEWEST_SEEDS else f"left {left} of {len(common)} seeds with a velocity"
            columns = (vs[common[:, goal.place], goal.place] for vs in self.trials.values())
            if not words and goal.name == "sd" and any(np.ptp(column) == 0.0 for column in columns):
                words = "gave all seeds the same velocity, and no standard deviation to fit,"
            if words:
                self.trials = former
                raise _UnreadTrialError(f"a trial {words} at {goal.target.content:g} %")

    @property
    def common(self) -> NDArray[np.bool_]:
        """Used seeds at each content, (seeds, contents): those with a velocity in every trial."""
        return np.asarray(np.isfinite(list(self.trials.values())).all(axis=0))

    def near(self, point: Floats) -> list[Floats]:
        """Trials near a point, within which Vs is linear in the logarithms of the parameters."""
        trials = [np.frombuffer(key) for key in self.trials]
        return [other for other in trials if np.abs(other - point).max() < 0.3]  # in the logarithm of each

    def deviation(self, point: Floats) -> Floats:
        """Logarithms of the goals' means and standard deviations over their values, (R,)."""
        return np.log([goal.of(vs) / goal.value for goal, vs in self.columns(point)])

    def errors(self, point: Floats) -> Floats:
        """Standard errors of `deviation` for normal scatter, (R,), from target, trial and the model's tolerance."""
        variances = [
            goal.variance_of_target(vs) + (goal.variance(vs, len(vs)) if goal.target.content else 0.0)
            for goal, vs in self.columns(point)
        ]
        return np.hypot(max(self.tolerance, 1e-6), np.sqrt(variances))  # the sample without cement may have no other

    def covariance(self, point: Floats) -> Floats:
        """Covariance of `deviation` by sampling, (R, R).

        For the trial it follows from the influence of each seed at all contents, without assuming normal scatter or
        independent contents (Efron & Tibshirani 1993, chapter 21). For the targets normal scatter is assumed.
        """
        influence = []
        for goal, vs in self.columns(point):
            from_mean, of_seeds = vs - vs.mean(), np.zeros(len(self.common))
            change = from_mean / vs.mean() if goal.name == "mean" else 0.5 * (from_mean**2 / vs.var() - 1.0)
            of_seeds[self.common[:, goal.place]] = change / math.sqrt(len(vs) * (len(vs) - 1))
            influence.append(of_seeds)
        of_targets = [goal.variance_of_target(vs) for goal, vs in self.columns(point)]
        return np.asarray(np.array(influence) @ np.array(influence).T + np.diag(of_targets))

    def columns(self, point: Floats) -> list[tuple[_Goal, Floats]]:
        """Each goal with the used velocities of its content."""
        vs, common = self.trials[point.tobytes()], self.common
        return [(goal, vs[common[:, goal.place], goal.place]) for goal in self.goals]


def calibrate(
    configuration: Configuration,
    packing: Packing,
    plan: FitPlan,
    database: Path,
    executor: Executor | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> FittedParameters:
    """Fit parameters to means and standard deviations of Vs by weighted least squares of their logarithms.

    Every trial is a campaign in ``database``, computed by the workers of ``executor`` or in this process, and reported
    by ``tell``; a repeated fit computes only what is missing. `ConfigurationError` if a parameter cannot be fitted, the
    packing cannot hold the cells, or there are more parameters than numbers to meet.

    The method is Gauss-Newton on the logarithms of the parameters, within their ranges, with one-sided differences. A
    step without improvement is halved. A content with fewer than three readable seeds is left out. The result lists
    objections to it.
    """
    start = list(plan.start(configuration, packing).values())
    every = sorted({row.content for row in plan.targets} | set(plan.predict))
    try:
        planned = point_of_study(configuration, database, every, plan.seeds)
    except ValueError as error:
        raise ConfigurationError("cells", [Problem(str(error))]) from error
    if problems := cross_check(planned):
        raise ConfigurationError("cells", problems)
    check_against_packing(planned, packing)
    contents = [target.content for target in plan.met]

    def velocities(values: ParameterValues, contents: Sequence[float] = contents) -> Floats:
        try:
            tried = change_configuration(replace(configuration, campaign=planned.campaign), values)
        except ValueError:  # refused values give no velocity
            return np.full((len(plan.seeds), len(contents)), np.nan)
        return point_velocities(point_of_study(tried, database, contents, plan.seeds), executor)

    fitted = _fit_to_targets(lambda tried: [velocities(values) for values in tried], plan, start, tell)
    if not plan.predict:
        return fitted
    known = {target.content: target for target in plan.targets}
    predictions = (
        _summary(content, known.get(content), vs, np.isfinite(vs), "predicted")
        for content, vs in zip(plan.predict, velocities(fitted.values, plan.predict).T, strict=True)
    )
    return replace(fitted, contents=(*fitted.contents, *predictions))


def _fit_to_targets(
    measure: Callable[[Sequence[ParameterValues]], Sequence[Floats]],
    plan: FitPlan,
    start: Sequence[float],
    tell: Callable[[str], None] = lambda _: None,
) -> FittedParameters:
    """Fit as `calibrate` does, to any source of velocities.

    ``measure`` takes values of the parameters, first ``start``, and returns Vs for each, (seeds, contents of the
    targets), NaN if missing. The caller makes predictions. Errors are those of `calibrate`.
    """
    names, wanted = [chosen.name for chosen in plan.free], len(plan.goals)
    problems = []
    if len(names) > wanted:
        problem = f"parameters = {len(names)}: give at most {wanted}, one for each mean and standard deviation"
        problems.append(Problem(problem))
    if not 0.0 <= plan.tolerance < math.inf:
        problems.append(Problem(f"tolerance = {plan.tolerance}: give a number of 0 or more, such as 0.02"))
    if problems:
        raise ConfigurationError("calibration", problems)
    with np.errstate(divide="ignore"):  # a missing lower limit is 0, with logarithm minus infinity
        limits = np.log([[chosen.low, chosen.high] for chosen in plan.free])
    fit = _Fit(lambda points: measure([_values_at(names, point) for point in points]), plan)
    point, slopes, doubts = _descend(fit, np.log(start), limits, names, tell)
    vs, common = fit.trials[point.tobytes()], fit.common
    contents = tuple(
        _summary(
            target.content,
            target,
            vs[:, i],
            common[:, i],
            "fitted" if slopes.size and i in fit.used else "left out",
        )
        for i, target in enumerate(plan.met)
    )
    for row in contents:
        read = f"at {row.content:g} % {row.seeds} of {row.planned} seeds have a velocity in every trial"
        if row.seeds < _FEWEST_SEEDS:
            cure = "start from values with readable waves, or change wave.frequency"
            doubts.append(f"{read}, so it was left out: {cure}")
        elif row.seeds < 0.5 * row.planned:
            doubts.append(f"{read}: the others may have another mean and scatter")
    unknown = np.full(len(names), math.nan)
    fitted = FittedParameters(
        values=_values_at(names, point),
        deviations=_values_at(names, unknown),
        correlation=np.outer(unknown, unknown),
        at_limit=(),
        contents=contents,
        trials=len(fit.trials),
        chi_square=math.nan,
        freedom=len(fit.goals) - len(names),
        doubts=tuple(doubts),
    )
    if not slopes.size:
        return fitted
    errors, moves = fit.errors(point), slopes.any(axis=0)
    slopes, missed = _slopes_of_all(fit, point, slopes)
    inverse = np.linalg.pinv(slopes / errors[:, None]) / errors
    covariance = inverse @ (fit.covariance(point) + np.diag(missed)) @ inverse.T
    deviation = np.where(moves, np.sqrt(np.diag(covariance)), np.nan)
    doubts += [f"{names[i]} does not change Vs at these contents: remove it" for i in np.flatnonzero(~moves)]
    at_limit = np.isclose(point[:, None], limits, atol=1e-6).any(axis=1)
    chi_square = float(np.sum((fit.deviation(point) / errors) ** 2))
    doubts += [f"{names[i]} ended at a limit of its range: widen it, or remove it" for i in np.flatnonzero(at_limit)]
    if chi_square > 4.0 * max(1, fitted.freedom):  # above that, deviations are not random
        doubts.append(
            "the targets are not met within their errors: free other parameters; the deviations are too small"
        )
    intervals, bands = _open_questions(fit, point, limits)
    doubts += [
        f"the 95 % interval of {name} does not hold its value: use more seeds"
        for name, value, (low, high) in zip(names, np.exp(point), intervals, strict=False)
        if not low <= value <= high
    ]
    banded = tuple(
        replace(row, mean_band=bands.get((row.content, "mean")), sd_band=bands.get((row.content, "sd")))
        for row in contents
    )
    return replace(
        fitted,
        deviations=_values_at(names, point + np.log(deviation)),
        correlation=covariance / np.outer(deviation, deviation),
        at_limit=tuple(names[i] for i in np.flatnonzero(at_limit)),
        contents=banded,
        chi_square=chi_square,
        doubts=tuple(doubts),
        intervals=dict(zip(names, intervals, strict=False)),
    )


def _slopes_of_all(fit: _Fit, point: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """Slopes (R, P) from all trials near a point, and the variance of a trial about them, (R,).

    Noise in the few trials of one round steepens slopes and makes the deviations of the parameters too small. If the
    trials do not suffice, the given slopes are returned.
    """
    near = fit.near(point)
    with suppress(ValueError):
        line, missed = linear_model(np.array(near), np.array([fit.deviation(other) for other in near]))
        return line[1:].T, missed
    return slopes, np.zeros(len(slopes))


def _open_questions(
    fit: _Fit, point: Floats, limits: Floats
) -> tuple[list[tuple[float, float]], Mapping[tuple[float, Literal["mean", "sd"]], tuple[float, float]]]:
    """Intervals of the parameters, and bands by content and name; empty with too few trials near the point."""
    near, goals = fit.near(point), fit.goals
    fresh = [goal.variance(vs, goal.target.samples or len(vs)) for goal, vs in fit.columns(point)]
    try:
        points, predicted = draw_posterior(
            np.array(near),
            np.array([fit.deviation(other) for other in near]),
            np.zeros(len(goals)),
            fit.covariance(point) + fit.tolerance**2 * np.eye(len(goals)),
            np.sqrt(fresh),
            limits,
        )
    except (ValueError, np.linalg.LinAlgError):
        return [], {}
    within = (0.025, 0.975)
    ends = np.exp(np.quantile(predicted, within, axis=0)).T.tolist()
    bands = {
        (goal.target.content, goal.name): (low * goal.value, high * goal.value)
        for goal, (low, high) in zip(goals, ends, strict=True)
    }
    return [(low, high) for low, high in np.exp(np.quantile(points, within, axis=0)).T.tolist()], bands


def _values_at(names: Sequence[str], point: Floats) -> dict[str, float]:
    """Values by name, from their logarithms."""
    return dict(zip(names, np.exp(point).tolist(), strict=True))


def _descend(
    fit: _Fit, start: Floats, limits: Floats, names: Sequence[str], tell: Callable[[str], None]
) -> tuple[Floats, Floats, list[str]]:
    """Point of the least weighted squares, slopes (R, P) of the last round, and reasons of an early end.

    Empty slopes mean that nothing could be fitted.
    """
    point, slopes, converged, nearer, unread = start, np.empty((0, 0)), False, None, ""
    most_rounds = 6  # from a start within a factor of two, three suffice
    relative = 0.06  # step of the derivatives; Vs is not smooth, since whole contacts and clusters change
    largest = math.log(2.0)  # change of a logarithm in one round
    for number in range(most_rounds):
        steps = np.where(point + relative > limits[:, 1], -relative, relative)
        beside = [point + step * unit for step, unit in zip(steps, np.eye(len(point)), strict=True)]
        if number == 0:
            fit.begin([point, *beside])
            if len(fit.goals) < len(names):
                cure = "give more seeds, or free fewer parameters"
                return point, slopes, [f"{len(fit.goals)} readable numbers for {len(names)} parameters: {cure}"]
        try:
            fit.try_points([point, *beside])
        except _UnreadTrialError as error:
            tell(f"Ended before it converged: {error}")
            return point, slopes, [f"it ended before it converged: {error}"]
        own, errors = fit.deviation(point), fit.errors(point)
        tell(_told(names, point, fit))
        slopes = np.array([(fit.deviation(other) - own) / step for other, step in zip(beside, steps, strict=True)]).T
        low, high = np.maximum(limits.T[0] - point, -largest), np.minimum(limits.T[1] - point, largest)
        step = lsq_linear(slopes / errors[:, None], -own / errors, bounds=(low - 1e-9, high + 1e-9)).x.clip(low, high)
        step[~slopes.any(axis=0)] = 0.0  # the direction is unknown
        nearer, unread = _nearer(fit, point, step, errors)
        # The statistical error of the parameters is larger than 1 %.
        converged = nearer is None or bool(np.abs(nearer - point).max() < 0.01)
        point = point if nearer is None else nearer
        if converged:
            break
    tell(_told(names, point, fit))
    doubts = [] if converged else [f"it has not converged in {most_rounds} rounds: restart from its result"]
    if nearer is None and unread:
        doubts.append(f"it ended before it converged: {unread}")
    return point, slopes, doubts


def _nearer(fit: _Fit, point: Floats, step: Floats, errors: Floats) -> tuple[Floats | None, str]:
    """First point of improvement for the step, its half, its quarter and so on, or None.

    Also the reason why a trial among them could not be compared; empty if all could.
    """
    unread = ""
    for halvings in range(4):
        other = np.asarray(point + step / 2**halvings)
        try:
            fit.try_points([other])
        except _UnreadTrialError as error:
            unread = str(error)
            continue
        squares = [float(np.sum((fit.deviation(tried) / errors) ** 2)) for tried in (other, point)]
        if squares[0] < squares[1]:
            return other, unread
    return None, unread


def _told(names: Sequence[str], point: Floats, fit: _Fit) -> str:
    """Message about a point of a fit."""
    deviation, errors = fit.deviation(point), fit.errors(point)
    parts = [f"{goal.name} at {goal.target.content:g} %" for goal in fit.goals]
    shown = ", ".join(f"{name} {value:.4g}" for name, value in _values_at(names, point).items())
    ratios = ", ".join(f"{part} {ratio:.3f}" for part, ratio in zip(parts, np.exp(deviation), strict=True))
    return f"{shown}: over target {ratios}; chi-square {np.sum((deviation / errors) ** 2):.2f}"


def _summary(
    content: float,
    target: Target | None,
    vs: Floats,
    used: NDArray[np.bool_],
    role: Literal["fitted", "left out", "predicted"],
) -> FittedContent:
    """Row of the result for the velocities of one content, of which ``used`` count."""
    count, chosen = int(used.sum()), vs[used]
    mean = float(chosen.mean()) if count else math.nan
    sd = float(chosen.std(ddof=1)) if count > 1 else math.nan
    return FittedContent(content, target, role, count, len(vs), mean, sd / math.sqrt(max(count, 1)), sd)


def linear_model(trials: Floats, statistics: Floats) -> tuple[Floats, Floats]:
    """Statistics (T, R) as linear functions of trials (T, P): constants and slopes (1 + P, R), residual variance (R,).

    `ValueError` if the trials do not determine all slopes.
    """
    count, parameters = trials.shape
    design = np.column_stack([np.ones(count), trials])
    line, _, rank, _ = np.linalg.lstsq(design, statistics, rcond=None)
    if rank <= parameters:
        raise ValueError(f"trials = {count}: give {parameters + 1} or more that differ in every parameter")
    return line, np.sum((statistics - design @ line) ** 2, axis=0) / max(1, count - parameters - 1)


def draw_posterior(
    trials: Floats,
    statistics: Floats,
    wanted: Floats,
    covariance: Floats,
    fresh: Floats,
    limits: Floats,
    draws: int = 4000,
) -> tuple[Floats, Floats]:
    """Draw parameters by importance sampling with a linear model of the trials of a calibration.

    Returns the logarithms of the parameters (D, P), with equal weights, and those of the means and standard deviations
    of a new campaign with them (D, R). `ValueError` unless there are more trials than parameters and they do not lie in
    a hyperplane.

    Parameters
    ----------
    trials
        (T, P) logarithms of the parameters of the trials.
    statistics
        (T, R) logarithms of their means and standard deviations.
    wanted
        (R,) logarithms of the targets.
    covariance
        (R, R) covariance of the errors of targets and trials, including the tolerance of the model.
    fresh
        (R,) standard errors of the statistics of a new campaign, in log.
    limits
        (P, 2) logarithms of the ranges, with a uniform prior between them.
    draws
        Number of draws.

    Notes
    -----
    The residual of the linear model counts as an additional independent error of each number. Importance weights are
    the posterior over a wider Student's t around its mode (Robert & Casella 2004, chapter 3); draws are resampled by
    them.
    """
    parameters, (line, missed) = trials.shape[1], linear_model(trials, statistics)
    inverse = np.linalg.inv(covariance + np.diag(missed))
    slopes = line[1:].T  # (R, P)
    spread = np.linalg.inv(slopes.T @ inverse @ slopes)
    mode = spread @ slopes.T @ inverse @ (wanted - line[0])
    generator = np.random.default_rng(20_250_601)
    # A proposal wider than the posterior of the linear model avoids a long tail of weights.
    proposal = stats.multivariate_t(mode, 1.3 * 0.5 * (spread + spread.T), df=5, seed=generator)
    found = np.atleast_2d(proposal.rvs(4 * draws)).reshape(-1, parameters)
    left = wanted - line[0] - found @ slopes.T
    inside = ((found >= limits[:, 0]) & (found <= limits[:, 1])).all(axis=1)
    logs = -0.5 * np.einsum("dr,rs,ds->d", left, inverse, left) - proposal.logpdf(found)
    if not inside.any():
        raise ValueError("limits: no draw lies within the ranges of the parameters: widen them")
    weights = np.where(inside, np.exp(logs - logs[inside].max()), 0.0)
    weights /= weights.sum()
    chosen = found[generator.choice(len(found), size=draws, p=weights)]
    noise = generator.standard_normal((draws, len(wanted))) * np.hypot(np.sqrt(missed), fresh)
    return chosen, line[0] + chosen @ slopes.T + noise
