"""Prediction of Vs of samples that were not simulated, from simulated ones of the same content."""

import math
from typing import NamedTuple

import numpy as np

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.fits import FEWEST_ROWS, Prediction, VelocityPredictor, check_samples
from calcidem.analysis.packing_graph import PackingGraph
from calcidem.app.campaign.patterns import pattern_of
from calcidem.dem.kernels.layout import Flags, Floats, Integers
from calcidem.dem.sample.cement import CementCapacityError
from calcidem.dem.wave.experiment import Experiment
from calcidem.ends import CellStatus
from calcidem.storage.errors import QueryError
from calcidem.storage.records import CementPattern, NetworkFeatures
from calcidem.storage.store import Selection


class _Samples(NamedTuple):
    """Samples of a content that have a velocity."""

    features: Floats
    """(n, 1) logarithms of the conductance, or (n, 0)."""
    vs: Floats
    """(n,) m/s."""
    seeds: Integers
    """(n,)."""


def predict_velocity(
    analysis: CampaignAnalysis,
    content: float,
    pattern: CementPattern | None = None,
    level: float = 0.95,
    without_seed: int | None = None,
) -> Prediction:
    """Predict Vs of a sample of a content (%) of a campaign, with an interval.

    With the sample's cement the prediction uses its conductance (`packing_graph.NETWORK_FEATURES`), without it the
    content alone. The seed to predict
    takes no part in the fit. `QueryError` if the cement is not that of a sample of this content, or the campaign has
    too few velocities there.
    """
    if not 0.0 < level < 1.0:
        raise QueryError(f"level = {level}: is not a probability.", "Give one between 0 and 1, such as 0.95.")
    contents = analysis.vs["content"].to_numpy()
    if not np.isclose(contents, content).any():
        known = ", ".join(f"{known:g}" for known in contents)
        raise QueryError(f"content = {content:g} %: the campaign has no such cells.", f"Choose among {known} %.")
    table, vs, seeds = _samples_at(
        analysis, float(contents[np.argmin(np.abs(contents - content))]), with_cement=pattern is not None
    )
    others = np.ones(len(vs), dtype=bool) if without_seed is None else seeds != without_seed
    fewest = FEWEST_ROWS + 1 + table.shape[1]  # one more than a fit needs, for checking
    if others.sum() < fewest:
        problem = f"{others.sum()} cells at {content:g} % have a velocity."
        raise QueryError(problem, f"Compute at least {fewest} seeds.")
    features: Floats = np.empty(0)
    if pattern is not None and table.shape[1]:
        features = np.array([_conductance_of(analysis.graphs[0], pattern)])
        _refuse_far_conductance(content, float(features[0]), table[others, 0])
    return VelocityPredictor.fit(table[others], vs[others], level).predict(features)


def check_predictions(
    analysis: CampaignAnalysis, level: float = 0.95, *, with_cement: bool = True
) -> dict[float, tuple[Flags, Floats]]:
    """Predict every sample from the other seeds of its content: see `check_samples`, by content.

    Contents with few velocities or without scatter are left out; without cement all seeds are the same sample.
    """
    contents = analysis.vs["content"].to_numpy().tolist()
    found = {content: _samples_at(analysis, content, with_cement=with_cement) for content in contents}
    return {
        content: check_samples(samples.features, samples.vs, level)
        for content, samples in found.items()
        if len(samples.vs) > FEWEST_ROWS + samples.features.shape[1] and np.ptp(samples.vs) > 0.0
    }


def draw_pattern(experiment: Experiment, seed: int, content: float) -> CementPattern:
    """Draw the cement of a seed at a content in percent; `QueryError` if the sample cannot hold it."""
    try:
        cement = experiment.ordering(seed).at(content)
    except CementCapacityError as error:
        raise QueryError(f"seed = {seed}: {error}.", "Choose a lower content.") from error
    return pattern_of(experiment.packing, cement)


def conductances(analysis: CampaignAnalysis, content: float) -> dict[int, float]:
    """Logarithm of the conductance of the samples of a content with a velocity and known cement, by seed."""
    cells = analysis.outcomes_of(Selection(contents=content, statuses=CellStatus.DONE), ("cement",))
    return {
        cell.key.seed: _conductance_of(analysis.graphs[cell.packing_index], cell.cement, cell.network)
        for cell in cells
        if cell.cement is not None
    }


def _samples_at(analysis: CampaignAnalysis, content: float, *, with_cement: bool) -> _Samples:
    """Samples of a content; those without known cement are left out, unless it cannot be drawn again for any."""
    column = analysis.vs.sel(content=content).dropna("seed")
    known = conductances(analysis, content) if with_cement else {}
    if known:
        column = column.sel(seed=[seed for seed in column["seed"].to_numpy().tolist() if seed in known])
    seeds, vs = column["seed"].to_numpy(), column.to_numpy().astype(float)
    table = np.array([[known[seed]] for seed in seeds.tolist()]) if known else np.empty((len(vs), 0))
    return _Samples(table, vs, seeds)


def _conductance_of(graph: PackingGraph, pattern: CementPattern, network: NetworkFeatures | None = None) -> float:
    """Logarithm of the conductance of a pattern; `QueryError` if it cements grains that do not touch.

    Vs is about a power of the conductance.
    """
    try:
        found = network or graph.network.features(graph.bonded(pattern))
    except ValueError as error:
        raise QueryError(f"{error}.", "Give the contacts of a sample of this campaign.") from error
    return math.log(found.network_conductance or math.nan)


def _refuse_far_conductance(content: float, value: float, known: Floats) -> None:
    """Raise a `QueryError` if a conductance is outside the range of the samples, (n,), by more than this range."""
    low, high = float(known.min()), float(known.max())
    if high > low and not 2.0 * low - high <= value <= 2.0 * high - low:
        shown, least, most = (f"{math.exp(one):.3g}" for one in (value, low, high))
        problem = f"network_conductance = {shown} is far from the {least} to {most} of the samples at {content:g} %."
        raise QueryError(problem, "Give cement that a sample of this content has.")
