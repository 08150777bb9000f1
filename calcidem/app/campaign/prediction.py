"""Vs of samples that were not simulated, from those of their content that were."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict

import numpy as np
import numpy.typing as npt
import xarray as xr

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.features import FEATURES
from calcidem.analysis.packing_graph import PackingGraph
from calcidem.analysis.predictor import Prediction, PredictorCheck, check_predictor, fit_predictor
from calcidem.app.campaign.patterns import pattern_of
from calcidem.dem.sample.cement import CementCapacityError
from calcidem.dem.wave.experiment import Experiment
from calcidem.storage.dataset import campaign_dataset
from calcidem.storage.errors import QueryError
from calcidem.storage.records import CellStatus, CementPattern
from calcidem.storage.store import Selection

PATH_FEATURES = tuple(feature.name for feature in FEATURES)
COLUMN = "column_share"
"""Share of the contacts at the height of the receiver that are cemented."""

FEATURE_NAMES = (*PATH_FEATURES, COLUMN)

_FEWEST_VELOCITIES = 4
"""A predictor needs three, and one more to be tried on."""


def predict_velocity(
    analysis: CampaignAnalysis,
    content: float,
    features: Mapping[str, float],
    level: float = 0.95,
    without_seed: int | None = None,
) -> Prediction:
    """Predict Vs of a sample.

    Parameters
    ----------
    analysis
        Of the campaign to whose samples of this content the predictor is fitted.
    content
        Of the campaign, percent.
    features
        Those of the sample that are known, by their names in `calcidem.analysis.features.FEATURES`, or `COLUMN`; with
        none the content alone is left.
    level
        Probability of the interval.
    without_seed
        Seed that takes no part, since it is the one to predict.

    Raises
    ------
    QueryError
        If a name is unknown, a value far from those of all samples, or the campaign has too few velocities at the
        content.
    """
    names = tuple(features)
    if strange := sorted(set(names) - set(FEATURE_NAMES)):
        raise QueryError(f"{', '.join(strange)}: no such feature.", f"Choose among {', '.join(FEATURE_NAMES)}.")
    shares = _column_shares(analysis, [content], names)
    names = _known_of(names, shares)
    cells = campaign_dataset(analysis.store, ("vs", *(name for name in names if name != COLUMN)))
    table, vs, seeds = _velocities_at(cells, content, names, shares)
    others = seeds != (-1 if without_seed is None else without_seed)
    if others.sum() < _FEWEST_VELOCITIES:
        problem = f"{others.sum()} cells at {content:g} % have a velocity and these features."
        raise QueryError(problem, f"Compute at least {_FEWEST_VELOCITIES} seeds first.")
    _refuse_far_features(content, names, features, table[others])
    predictor = fit_predictor(table[others], vs[others], level, _choices(names))
    return predictor.predict([features[name] for name in names])


def check_predictions(
    analysis: CampaignAnalysis, names: Sequence[str] = FEATURE_NAMES, level: float = 0.95
) -> dict[float, PredictorCheck]:
    """Predict every sample from the other seeds of its content, by content.

    Contents with few velocities are left out, and those without scatter: uncemented, all seeds are the same sample.
    """
    cells = campaign_dataset(analysis.store, ("vs", *(name for name in names if name != COLUMN)))
    contents = cells["content"].to_numpy().tolist()
    shares = _column_shares(analysis, contents, names)
    names = _known_of(names, shares)
    samples = {content: _velocities_at(cells, content, names, shares) for content in contents}
    return {
        content: check_predictor(table, vs, level, _choices(names))
        for content, (table, vs, _) in samples.items()
        if len(vs) >= _FEWEST_VELOCITIES and np.ptp(vs) > 0.0
    }


def _refuse_far_features(
    content: float, names: Sequence[str], features: Mapping[str, float], table: npt.NDArray[np.float64]
) -> None:
    """Raise a `QueryError` if a value lies outside those of the samples, (n, k), by more than they differ."""
    for name, low, high in zip(names, table.min(axis=0).tolist(), table.max(axis=0).tolist(), strict=True):
        if high > low and not 2.0 * low - high <= features[name] <= 2.0 * high - low:
            problem = (
                f"{name} = {features[name]:g} is far from the {low:g} to {high:g} of the samples at {content:g} %."
            )
            raise QueryError(problem, "Give what a sample of this content has.")


def _known_of(names: Sequence[str], shares: Collection[tuple[int, float]]) -> tuple[str, ...]:
    """Names of features that samples of the campaign have: where no cement can be drawn again, the path's alone."""
    return tuple(name for name in names if shares or name != COLUMN)


def _choices(names: Sequence[str]) -> list[list[int]]:
    """Columns of what may be taken: the cement at the receiver's height, the path, or both."""
    column = [number for number, name in enumerate(names) if name == COLUMN]
    path = [number for number, name in enumerate(names) if name != COLUMN]
    return [columns for columns in (column, path, column + path) if columns]


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


def pattern_features(graph: PackingGraph, pattern: CementPattern) -> dict[str, float]:
    """Features of a cement pattern in a packing, by their names in `FEATURE_NAMES`.

    Raises
    ------
    QueryError
        If the pattern cements grains that do not touch, or nothing joins transmitter and receiver.
    """
    try:
        bonded = graph.bonded(pattern)
        found = asdict(graph.features(graph.shortest_paths(bonded)))
    except ValueError as error:
        raise QueryError(f"{error}.", "Give the contacts of a sample of this campaign.") from error
    known = {name: float(found[name]) for name in PATH_FEATURES if found[name] is not None}
    return {**known, COLUMN: graph.column_share(bonded)}


def _column_shares(
    analysis: CampaignAnalysis, contents: Collection[float], names: Sequence[str]
) -> dict[tuple[int, float], float]:
    """`COLUMN`, if it is wanted, of all samples with a velocity whose cement is known, by seed and content."""
    shares: dict[tuple[int, float], float] = {}
    if COLUMN not in names:
        return shares
    graphs = analysis.graphs
    for cell in analysis.outcomes_of(Selection(contents=contents, statuses=CellStatus.DONE), ("cement",)):
        if cell.cement is not None:
            graph = graphs[cell.packing_index]
            shares[cell.key.seed, cell.key.content] = graph.column_share(graph.bonded(cell.cement))
    return shares


def _velocities_at(
    cells: xr.Dataset, content: float, names: Sequence[str], shares: Mapping[tuple[int, float], float]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Features (n, k), Vs in m/s (n,) and seeds (n,) of the samples at a content that have them all."""
    contents = cells["content"].to_numpy()
    if not np.isclose(contents, content).any():
        known = ", ".join(f"{known:g}" for known in contents)
        raise QueryError(f"content = {content:g} %: the campaign has no such cells.", f"Choose among {known} %.")
    cells = cells.isel(content=int(np.argmin(np.abs(contents - content))))
    vs, seeds = cells["vs"].to_numpy().astype(float), cells["seed"].to_numpy()
    found = {name: cells[name].to_numpy() for name in names if name != COLUMN}
    found[COLUMN] = np.array([shares.get((seed, float(cells["content"])), np.nan) for seed in seeds.tolist()])
    table = np.array([found[name] for name in names], dtype=float).reshape(len(names), len(vs))
    known = np.isfinite(vs) & np.isfinite(table).all(axis=0)
    return table[:, known].T, vs[known], seeds[known]
