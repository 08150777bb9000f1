"""Prediction of Vs of samples that were not simulated, from simulated ones of the same content."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.packing_graph import FEATURES, PackingGraph
from calcidem.analysis.predictor import (
    FEWEST_ROWS,
    Prediction,
    PredictorCheck,
    VelocityPredictor,
)
from calcidem.app.campaign.patterns import pattern_of
from calcidem.dem.sample.cement import CementCapacityError
from calcidem.dem.wave.experiment import Experiment
from calcidem.storage.dataset import campaign_dataset
from calcidem.storage.errors import QueryError
from calcidem.storage.records import CellStatus, CementPattern
from calcidem.storage.store import Selection

CEMENT_FEATURES = ("column_share", "cemented_share")
"""Cemented shares of the contacts at the receiver's height and of all contacts, from which Vs is predicted."""

_FEATURE_NAMES = (*FEATURES, *CEMENT_FEATURES)


_Shares = dict[tuple[int, float], tuple[float, float]]


def predict_velocity(
    analysis: CampaignAnalysis,
    content: float,
    features: Mapping[str, float],
    level: float = 0.95,
    without_seed: int | None = None,
) -> Prediction:
    """Predict Vs of a sample of a content (%) of a campaign, with an interval.

    Known features of the sample are given by their names in `calcidem.analysis.packing_graph.FEATURES` or
    `CEMENT_FEATURES`; without any the prediction uses the content alone. The seed to predict takes no part in the fit.
    `QueryError` if a name is unknown, a value is far from those of all samples, or the campaign has too few velocities
    at the content.
    """
    if not 0.0 < level < 1.0:
        raise QueryError(f"level = {level}: is not a probability.", "Give one between 0 and 1, such as 0.95.")
    names = tuple(features)
    if strange := sorted(set(names) - set(_FEATURE_NAMES)):
        raise QueryError(f"{', '.join(strange)}: no such feature.", f"Choose among {', '.join(_FEATURE_NAMES)}.")
    shares = cement_shares(analysis, [content], names)
    names = _known_of(names, shares)
    table, vs, seeds = _velocities_at(_cells_with(analysis, names), content, names, shares)
    others = seeds != (-1 if without_seed is None else without_seed)
    fewest = FEWEST_ROWS + 1 + len(names)  # one more than a fit needs, for checking
    if others.sum() < fewest:
        problem = f"{others.sum()} cells at {content:g} % have a velocity and these features."
        raise QueryError(problem, f"Compute at least {fewest} seeds, or give fewer features.")
    _refuse_far_features(content, names, features, table[others])
    predictor = VelocityPredictor.fit(table[others], vs[others], level)
    return predictor.predict([features[name] for name in names])


def check_predictions(
    analysis: CampaignAnalysis, names: Sequence[str] = CEMENT_FEATURES, level: float = 0.95
) -> dict[float, PredictorCheck]:
    """Predict every sample from the other seeds of its content, by content.

    Contents with few velocities or without scatter are left out; without cement all seeds are the same sample.
    """
    contents = analysis.vs["content"].to_numpy().tolist()
    shares = cement_shares(analysis, contents, names)
    names = _known_of(names, shares)
    cells = _cells_with(analysis, names)
    samples = {content: _velocities_at(cells, content, names, shares) for content in contents}
    return {
        content: PredictorCheck.of_samples(table, vs, level)
        for content, (table, vs, _) in samples.items()
        if len(vs) > FEWEST_ROWS + len(names) and np.ptp(vs) > 0.0
    }


def _cells_with(analysis: CampaignAnalysis, names: Sequence[str]) -> xr.Dataset:
    """Velocities and stored features of all cells."""
    return campaign_dataset(analysis.store, ("vs", *(name for name in names if name not in CEMENT_FEATURES)))


def _refuse_far_features(
    content: float, names: Sequence[str], features: Mapping[str, float], table: npt.NDArray[np.float64]
) -> None:
    """Raise a `QueryError` if a value is outside the range of the samples, (n, k), by more than this range."""
    for name, low, high in zip(names, table.min(axis=0).tolist(), table.max(axis=0).tolist(), strict=True):
        if high > low and not 2.0 * low - high <= features[name] <= 2.0 * high - low:
            problem = (
                f"{name} = {features[name]:g} is far from the {low:g} to {high:g} of the samples at {content:g} %."
            )
            raise QueryError(problem, "Give a value that samples of this content have.")


def _known_of(names: Sequence[str], shares: _Shares) -> tuple[str, ...]:
    """Names of the features of the campaign's samples; only those of the path if cement cannot be drawn again."""
    return tuple(name for name in names if shares or name not in CEMENT_FEATURES)


def draw_pattern(experiment: Experiment, seed: int, content: float) -> CementPattern:
    """Draw the cement of a seed at a content in percent; `QueryError` if the sample cannot hold it."""
    try:
        cement = experiment.ordering(seed).at(content)
    except CementCapacityError as error:
        raise QueryError(f"seed = {seed}: {error}.", "Choose a lower content.") from error
    return pattern_of(experiment.packing, cement)


def pattern_features(graph: PackingGraph, pattern: CementPattern) -> dict[str, float]:
    """`CEMENT_FEATURES` of a pattern, by name; `QueryError` if it cements grains that do not touch."""
    try:
        return dict(zip(CEMENT_FEATURES, _shares_of(graph, pattern), strict=True))
    except ValueError as error:
        raise QueryError(f"{error}.", "Give the contacts of a sample of this campaign.") from error


def cement_shares(analysis: CampaignAnalysis, contents: Collection[float], names: Sequence[str]) -> _Shares:
    """`CEMENT_FEATURES`, if needed, of samples with a velocity and known cement, by seed and content."""
    shares: _Shares = {}
    if not set(names) & set(CEMENT_FEATURES):
        return shares
    graphs = analysis.graphs
    for cell in analysis.outcomes_of(Selection(contents=contents, statuses=CellStatus.DONE), ("cement",)):
        if cell.cement is not None:
            shares[cell.key.seed, cell.key.content] = _shares_of(graphs[cell.packing_index], cell.cement)
    return shares


def _shares_of(graph: PackingGraph, pattern: CementPattern) -> tuple[float, float]:
    """`CEMENT_FEATURES` of a pattern."""
    bonded = graph.bonded(pattern)
    return graph.column_share(bonded), float(np.mean(bonded))


def _velocities_at(
    cells: xr.Dataset, content: float, names: Sequence[str], shares: _Shares
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Features (n, k), Vs in m/s (n,) and seeds (n,) of the complete samples at a content."""
    contents = cells["content"].to_numpy()
    if not np.isclose(contents, content).any():
        known = ", ".join(f"{known:g}" for known in contents)
        raise QueryError(f"content = {content:g} %: the campaign has no such cells.", f"Choose among {known} %.")
    cells = cells.isel(content=int(np.argmin(np.abs(contents - content))))
    vs, seeds = cells["vs"].to_numpy().astype(float), cells["seed"].to_numpy()
    found = {name: cells[name].to_numpy() for name in names if name not in CEMENT_FEATURES}
    nothing = (np.nan,) * len(CEMENT_FEATURES)
    rows = [shares.get((seed, float(cells["content"])), nothing) for seed in seeds.tolist()]
    found |= dict(zip(CEMENT_FEATURES, np.array(rows).T, strict=True))
    table = np.array([found[name] for name in names], dtype=float).reshape(len(names), len(vs))
    known = np.isfinite(vs) & np.isfinite(table).all(axis=0)
    return table[:, known].T, vs[known], seeds[known]
