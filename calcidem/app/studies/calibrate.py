"""Fitting what the paper leaves open to measured Vs: named parameters, few seeds, common random numbers."""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from calcidem.app.config.schema import Configuration
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure_all

FITTABLE = ("sand.wave_stiffness_factor", "pattern.p_share", "pattern.cluster_area", "cement.bond_modulus")
"""Parameters that can be fitted, as section.key of the configuration."""

_STEP = 0.06
"""Relative step of the derivatives: whole contacts and clusters come and go, so Vs is no smooth function."""

_MOST_TRIALS = 6
"""Points at which derivatives are taken; from a start within a factor of two, three are enough."""


@dataclass(frozen=True, slots=True)
class FittedParameters:
    """Parameters that a fit found.

    Attributes
    ----------
    values
        Fitted value of each parameter, in SI units.
    deviations
        Standard deviation of each, by the scatter of Vs between seeds.
    correlation
        (P, P) of the parameters.
    targets, fitted
        Mean Vs wanted and reached at each content, m/s.
    """

    values: Mapping[str, float]
    deviations: Mapping[str, float]
    correlation: Floats
    targets: Mapping[float, float]
    fitted: Mapping[float, float]


def start_value(configuration: Configuration, packing: Packing, name: str) -> float:
    """Value of a parameter to begin with; that of a cluster's area is Eq. 2 for the contacts of a mean cluster."""
    part, key = _place_of(name)
    value = getattr(getattr(configuration, part), key)
    if value is not None:
        return float(value)
    ordering = configuration.experiment(packing).ordering(configuration.campaign.seed_numbers[0])
    cement = ordering.at(min(5.0, ordering.maximum_content))
    calcite = (cement.content_reached - configuration.pattern.threshold) / 100.0
    densities = configuration.pattern.sand_density / configuration.pattern.calcite_density
    return float(calcite * densities * np.pi * np.sum(packing.radius**2) / max(1, cement.clusters))


def _place_of(name: str) -> tuple[str, str]:
    """Attribute of `Configuration` that a parameter belongs to, and its name there."""
    section, key = name.split(".")
    return "calibration" if key == "wave_stiffness_factor" else section, key


def with_values(configuration: Configuration, values: Mapping[str, float]) -> Configuration:
    """Configuration with some parameters changed."""
    changed = configuration
    for name, value in values.items():
        part, key = _place_of(name)
        changed = replace(changed, **{part: replace(getattr(changed, part), **{key: float(value)})})
    return changed


def calibrate(
    configuration: Configuration,
    packing: Packing,
    targets: Mapping[float, float],
    names: Sequence[str],
    seeds: Sequence[int],
    tell: Callable[[str], None] = lambda _: None,
) -> FittedParameters:
    """Fit parameters so that the mean Vs of some seeds meets targets, in relative least squares.

    Parameters
    ----------
    configuration
        Where to begin.
    packing
        Of the campaign.
    targets
        Mean Vs, m/s, by content in percent.
    names
        Parameters to fit, of `FITTABLE`; at most as many as targets.
    seeds
        The same in every trial, so that trials differ by the parameters alone.
    tell
        Told of every trial.

    Raises
    ------
    ValueError
        If a parameter is unknown, or there are more parameters than targets.
    """
    _refuse_names(names, targets)
    start = np.array([start_value(configuration, packing, name) for name in names])
    errors: dict[bytes, Floats] = {}

    # The unknowns are 1 + log(value / start): steps of derivatives are relative, and values stay positive.
    def residuals(unknown: Floats) -> Floats:
        values = dict(zip(names, np.exp(unknown - 1.0) * start, strict=True))
        means, standard_errors = mean_velocities(with_values(configuration, values), packing, list(targets), seeds)
        errors[unknown.tobytes()] = standard_errors / means
        ratios = means / np.array(list(targets.values()))
        shown = ", ".join(f"{name} {value:.4g}" for name, value in values.items())
        tell(f"{shown}: Vs over target {', '.join(f'{ratio:.3f}' for ratio in ratios)}")
        return np.asarray(np.log(ratios))

    steps = np.full(len(names), _STEP)
    fit = least_squares(residuals, np.ones(len(names)), diff_step=steps, method="dogbox", max_nfev=_MOST_TRIALS)
    inverse = np.linalg.pinv(np.asarray(fit.jac))
    covariance = inverse @ np.diag(errors[fit.x.tobytes()] ** 2) @ inverse.T
    deviation = np.sqrt(np.diag(covariance))
    values = np.exp(fit.x - 1.0) * start
    ratios = np.exp(fit.fun).tolist()
    return FittedParameters(
        values=dict(zip(names, values.tolist(), strict=True)),
        deviations=dict(zip(names, (values * deviation).tolist(), strict=True)),
        correlation=covariance / np.outer(deviation, deviation),
        targets=dict(targets),
        fitted={content: target * ratio for (content, target), ratio in zip(targets.items(), ratios, strict=True)},
    )


def _refuse_names(names: Sequence[str], targets: Mapping[float, float]) -> None:
    """Raise `ValueError` if a parameter cannot be fitted, or if there are more of them than targets."""
    strange = sorted(set(names) - set(FITTABLE))
    if strange:
        raise ValueError(f"parameter = {', '.join(strange)}: cannot be fitted; choose among {', '.join(FITTABLE)}")
    if not 0 < len(names) <= len(targets):
        raise ValueError(f"parameters = {len(names)}: give at least 1 and at most {len(targets)}, one for each target")


def mean_velocities(
    configuration: Configuration, packing: Packing, contents: Sequence[float], seeds: Sequence[int]
) -> tuple[Floats, Floats]:
    """Mean Vs of the seeds at each content and its standard error, m/s.

    Raises
    ------
    ValueError
        If fewer than two cells of a content have a velocity.
    """
    experiment, lanes = configuration.experiment(packing), configuration.run.lanes
    means, standard_errors = [], []
    for content in contents:
        cells = measure_all(experiment, content, seeds, lanes=lanes)
        found = [cell.vs for cell in cells if cell.vs is not None]
        if len(found) < 2:  # noqa: PLR2004 - a scatter needs two
            raise ValueError(
                f"content = {content} %: {len(found)} of {len(seeds)} cells have a velocity; change the start"
            )
        means.append(np.mean(found))
        standard_errors.append(max(np.std(found, ddof=1), 1e-6 * np.mean(found)) / np.sqrt(len(found)))
    return np.array(means), np.array(standard_errors)


def text_with_values(text: str, values: Mapping[str, float]) -> str:
    """TOML text with the values put in: keys that are there are replaced, others added to their section."""
    for name, value in values.items():
        section, key = name.split(".")
        line = f"{key} = {value:.5g}  # calibrated"
        body = re.compile(rf"(?ms)^\[{section}\]\s*$(.*?)(?=^\[|\Z)")
        found = body.search(text)
        if found is None:
            text = f"{text.rstrip()}\n\n[{section}]\n{line}\n"
            continue
        inside, count = re.subn(rf"(?m)^{key}\s*=.*$", line, found.group(1))
        if not count:
            inside = f"{inside.rstrip()}\n{line}\n\n"
        text = text[: found.start(1)] + inside + text[found.end(1) :]
    return text


def read_targets(file: Path) -> dict[float, float]:
    """Mean Vs by content from a CSV file.

    Raises
    ------
    ValueError
        If a column is missing or an entry is no positive number.
    """
    with file.open(encoding="utf-8", newline="") as source:
        rows = list(csv.DictReader(source))
    missing = sorted({"content", "vs"} - set(rows[0] if rows else ()))
    if missing:
        raise ValueError(f"{file}: no column {' and no column '.join(missing)}; give a header line 'content,vs'")
    try:
        targets = {float(row["content"]): float(row["vs"]) for row in rows}
    except ValueError as error:
        raise ValueError(f"{file}: {error}; give percent and m/s as numbers") from error
    if not all(vs > 0.0 for vs in targets.values()):
        raise ValueError(f"{file}: vs has to be positive, in m/s")
    return targets
