"""Vs of samples that were not simulated, from those of their content that were."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np
import numpy.typing as npt

from calcidem.analysis.features import FEATURES
from calcidem.analysis.packing_graph import PackingGraph
from calcidem.analysis.predictor import Prediction, PredictorCheck, check_predictor, fit_predictor
from calcidem.app.campaign.task import pattern_of
from calcidem.dem.sample.cement import CementCapacityError
from calcidem.dem.wave.experiment import Experiment
from calcidem.storage.campaign import StoredCampaign
from calcidem.storage.errors import QueryError
from calcidem.storage.records import CementPattern

FEATURE_NAMES = tuple(feature.name for feature in FEATURES)

_FEWEST_VELOCITIES = 4
"""A predictor needs three, and one more to be tried on."""


def predict_velocity(
    campaign: StoredCampaign,
    content: float,
    features: Mapping[str, float],
    level: float = 0.95,
    without_seed: int | None = None,
) -> Prediction:
    """Predict Vs of a sample.

    Parameters
    ----------
    campaign
        Whose samples of this content the predictor is fitted to.
    content
        Of the campaign, percent.
    features
        Those of the sample that are known, by their names in `calcidem.analysis.features.FEATURES`; with none the
        content alone is left.
    level
        Probability of the interval.
    without_seed
        Seed that takes no part, since it is the one to predict.

    Raises
    ------
    QueryError
        If a name is unknown, or the campaign has too few velocities at the content.
    """
    names = tuple(features)
    if strange := sorted(set(names) - set(FEATURE_NAMES)):
        raise QueryError(f"{', '.join(strange)}: no path feature.", f"Choose among {', '.join(FEATURE_NAMES)}.")
    table, vs, seeds = _velocities_at(campaign, content, names)
    others = seeds != (-1 if without_seed is None else without_seed)
    if others.sum() < _FEWEST_VELOCITIES:
        problem = f"{others.sum()} cells at {content:g} % have a velocity and these features."
        raise QueryError(problem, f"Compute at least {_FEWEST_VELOCITIES} seeds first.")
    return fit_predictor(table[others], vs[others], level).predict([features[name] for name in names])


def check_predictions(
    campaign: StoredCampaign, names: Sequence[str] = FEATURE_NAMES, level: float = 0.95
) -> dict[float, PredictorCheck]:
    """Predict every sample from the other seeds of its content, by content.

    Contents with few velocities are left out, and those without scatter: uncemented, all seeds are the same sample.
    """
    contents = campaign.to_xarray(("vs",))["content"].to_numpy().tolist()
    samples = {content: _velocities_at(campaign, content, names) for content in contents}
    return {
        content: check_predictor(table, vs, level)
        for content, (table, vs, _) in samples.items()
        if len(vs) >= _FEWEST_VELOCITIES and np.ptp(vs) > 0.0
    }


def draw_pattern(experiment: Experiment, seed: int, content: float) -> CementPattern:
    """Draw the cement of a seed at a content in percent.

    Raises
    ------
    QueryError
        If the sample cannot hold so much.
    """
    try:
        cement = experiment.ordering(seed).at(content)
    except CementCapacityError as error:
        raise QueryError(f"seed = {seed}: {error}.", "Choose a lower content.") from error
    return pattern_of(experiment.packing, cement)


def path_features(graph: PackingGraph, pattern: CementPattern) -> dict[str, float]:
    """Features of the path through a packing with a cement pattern.

    Raises
    ------
    QueryError
        If the pattern cements grains that do not touch, or nothing joins transmitter and receiver.
    """
    try:
        found = asdict(graph.features(graph.path(graph.bonded(pattern))))
    except ValueError as error:
        raise QueryError(f"{error}.", "Give the contacts of a sample of this campaign.") from error
    return {name: float(found[name]) for name in FEATURE_NAMES if found[name] is not None}


def _velocities_at(
    campaign: StoredCampaign, content: float, names: Sequence[str]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Features (n, k), Vs in m/s (n,) and seeds (n,) of the samples at a content that have them all."""
    cells = campaign.to_xarray(("vs", *(f"path_{name}" for name in names)))
    contents = cells["content"].to_numpy()
    if not np.isclose(contents, content).any():
        known = ", ".join(f"{known:g}" for known in contents)
        raise QueryError(f"content = {content:g} %: the campaign has no such cells.", f"Choose among {known} %.")
    column = cells.isel(content=int(np.argmin(np.abs(contents - content))))
    vs, seeds = column["vs"].to_numpy().astype(float), column["seed"].to_numpy()
    table = np.array([column[f"path_{name}"].to_numpy() for name in names], dtype=float).reshape(len(names), len(vs))
    known = np.isfinite(vs) & np.isfinite(table).all(axis=0)
    return table[:, known].T, vs[known], seeds[known]
