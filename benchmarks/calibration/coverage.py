"""Whether the errors that `calcidem calibrate` states hold the truth as often as they say: 200 synthetic truths.

    python benchmarks/calibration/coverage.py CONFIG.toml TARGETS.csv OUT.trials.jsonl --seeds 64 --first-seed 501 \
        --tolerance 0.03 --free sand.wave_stiffness_factor --free pattern.p_share

with the arguments of the calibration that left the trials. They give a surrogate of the simulation: logarithms of mean
and standard deviation linear in those of the parameters, and velocities of seeds with the distribution, and the
correlation between contents, that the simulated ones have. Of a seed between two trials as much stays as in the trials.
Each trial is predicted from the others first: that is the check against simulations. Nothing is simulated.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calcidem.analysis.measured import Target
from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.measured import read_targets
from calcidem.app.config.reader import load_configuration
from calcidem.app.studies.calibrate import FitPlan, ParameterValues, fit_to_targets
from calcidem.app.studies.kept_trials import KeptTrials
from calcidem.app.studies.parameters import parse_range, start_value, with_values

TRUTHS = 200
SPREAD = 0.1
"""Standard deviation of the logarithms of true parameters, around the last trial."""


TWO_SIDED = 1.96
"""Standard deviations that hold 95 % of a normal distribution."""


class EndOfTrialsError(Exception):
    """The calibration would go on from here."""


class Surrogate:
    """Velocities that a calibration may measure instead of simulated ones.

    Parameters
    ----------
    points
        (T, P) logarithms of the parameters of the trials.
    trials
        (T, S, C) their velocities, m/s; NaN where there is none.
    """

    def __init__(self, points: np.ndarray, trials: np.ndarray) -> None:
        self.points, self.trials = points, trials
        read = np.isfinite(trials).all(axis=(0, 2))  # seeds that are read everywhere
        kept = trials[:, read]
        self.mean, self.sd = kept.mean(axis=1), kept.std(axis=1, ddof=1)
        self.standard = (kept - self.mean[:, None]) / self.sd[:, None]
        self.statistics = np.log(np.hstack([self.mean, self.sd]))  # (T, 2 C)
        others = [(i, j) for i in range(len(points)) for j in range(i)]
        alike = [(self.standard[i] * self.standard[j]).mean(axis=0) for i, j in others]
        self.stays = np.clip(np.mean(alike, axis=0), 0.0, 1.0)  # (C,) correlation of a seed between trials
        self.line = self._fitted(np.ones(len(points), dtype=bool))

    def _fitted(self, chosen: np.ndarray) -> np.ndarray:
        design = np.column_stack([np.ones(chosen.sum()), self.points[chosen]])
        return np.linalg.lstsq(design, self.statistics[chosen], rcond=1e-6)[0]

    def at(self, point: np.ndarray, line: np.ndarray | None = None) -> np.ndarray:
        """(2, C) means and standard deviations, m/s."""
        values = np.concatenate([[1.0], point]) @ (self.line if line is None else line)
        return np.exp(values).reshape(2, -1)

    def check(self) -> np.ndarray:
        """(2 C,) root mean square of what the others say of each trial over what it is, in log."""
        errors = []
        for number in range(len(self.points)):
            chosen = np.arange(len(self.points)) != number
            errors.append(np.log(self.at(self.points[number], self._fitted(chosen)).ravel()) - self.statistics[number])
        return np.sqrt(np.mean(np.square(errors), axis=0))

    def rows(self, draws: np.random.Generator, count: int) -> np.ndarray:
        """(count, C) standardized velocities of so many seeds, those of a simulated seed together."""
        seed = draws.integers(self.standard.shape[1], size=count)
        return self.standard[draws.integers(len(self.standard), size=count), seed]


def replayed(options: argparse.Namespace) -> tuple[FitPlan, list[float], Surrogate]:
    """Go through a calibration on its kept trials alone, up to where it would simulate."""
    configuration = load_configuration(options.configuration)
    packing = provide_packing(configuration, None, lambda _: None)
    targets, free = read_targets(options.targets), [parse_range(text) for text in options.free]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    plan = FitPlan(targets, free, seeds, (), options.tolerance)

    def none(_configurations: object) -> object:
        raise EndOfTrialsError

    contents = [target.content for target in targets]
    known = KeptTrials(options.trials, packing).remembered(none, contents, seeds)  # type: ignore[arg-type]
    points: list[np.ndarray] = []
    trials: list[np.ndarray] = []

    def measure(tried: Sequence[ParameterValues]) -> list[np.ndarray]:
        found = []
        for values in tried:
            found.append(next(known([with_values(configuration, values)])))
            points.append(np.log(list(values.values())))
            trials.append(found[-1])
        return found

    start = [start_value(configuration, packing, chosen) for chosen in free]
    try:
        fit_to_targets(measure, plan, start)
    except EndOfTrialsError:
        print(f"the calibration goes on after its {len(points)} trials")
    return plan, start, Surrogate(np.array(points), np.array(trials))


def fit_truth(plan: FitPlan, start: list[float], surrogate: Surrogate, number: int) -> np.ndarray | None:
    """(P,) fitted parameters less true ones over the stated deviations, in log; None if it did not converge."""
    draws = np.random.default_rng([7, number])
    truth = surrogate.points[-1] + SPREAD * draws.standard_normal(len(plan.free))
    mean, sd = surrogate.at(truth)
    targets = []
    for column, target in enumerate(plan.targets):
        vs = mean[column] + sd[column] * surrogate.rows(draws, target.samples or 116)[:, column]
        targets.append(Target(target.content, float(vs.mean()), float(vs.std(ddof=1)), target.samples or 116))
    common = surrogate.rows(draws, len(plan.seeds))

    def measure(tried: Sequence[ParameterValues]) -> list[np.ndarray]:
        found = []
        for values in tried:
            point = np.log(list(values.values()))
            own = np.random.default_rng([number, *np.abs(1e6 * point).astype(int)])
            fresh = surrogate.rows(own, len(common))
            stays = np.sqrt(surrogate.stays)
            level, scatter = surrogate.at(point)
            found.append(np.maximum(level + scatter * (stays * common + np.sqrt(1 - stays**2) * fresh), 1.0))
        return found

    synthetic = FitPlan(targets, plan.free, plan.seeds, (), 0.0)
    fitted = fit_to_targets(measure, synthetic, start)
    if fitted.at_limit or any("converged" in doubt for doubt in fitted.doubts):
        return None
    values = np.log(list(fitted.values.values()))
    deviations = np.array(list(fitted.deviations.values())) / np.exp(values)
    return np.asarray((values - truth) / deviations)


def main() -> None:
    """Print the check of the surrogate, and how often the intervals hold the truth."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("configuration", type=Path)
    parser.add_argument("targets", type=Path)
    parser.add_argument("trials", type=Path)
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--tolerance", type=float, default=0.02)
    parser.add_argument("--free", action="append", required=True)
    plan, start, surrogate = replayed(parser.parse_args())
    wrong, contents = surrogate.check(), [target.content for target in plan.targets]
    for content, of_mean, of_sd, stays in zip(contents, *wrong.reshape(2, -1), surrogate.stays, strict=True):
        print(f"{content:g} %: trials from the others: mean {of_mean:.1%}, sd {of_sd:.1%}; a seed stays by {stays:.2f}")
    found = [fit_truth(plan, start, surrogate, number) for number in range(TRUTHS)]
    scores = np.array([score for score in found if score is not None])
    print(f"{len(scores)} of {TRUTHS} converged inside of their ranges")
    names = [*(chosen.name for chosen in plan.free), "all"]
    for name, row in zip(names, [*np.abs(scores).T, np.abs(scores).ravel()], strict=True):
        one, two = (float(np.mean(row < width)) for width in (1.0, TWO_SIDED))
        print(f"{name}: within 1 deviation {one:.0%}, within {TWO_SIDED} {two:.0%}")


if __name__ == "__main__":
    main()
