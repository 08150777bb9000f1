"""Which features predict Vs best, each sample from other seeds: `python docs/reproduction/predictors.py CAMPAIGN.db`.

The same features are used at every content. A negative difference to the content alone is a gain.
"""

import argparse

import numpy as np
import xarray as xr

from calcidem.analysis.predictor import VelocityPredictor
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.prediction import CEMENT_FEATURES, cement_features

C_DN = "path_normalized_connectivity"
COLUMN, CEMENTED = CEMENT_FEATURES
CANDIDATES: dict[str, tuple[str, ...]] = {
    "content alone": (),
    "column share": (COLUMN,),
    "C_d,n": (C_DN,),
    "column share, C_d,n": (COLUMN, C_DN),
    "column share, PLLC": (COLUMN, "path_longest_bonded_run_fraction"),
    "cemented share": (CEMENTED,),
    "column share, cemented share": (COLUMN, CEMENTED),
}
MEASURED: dict[str, tuple[str, ...]] = {
    "column share, effective_vs (measured)": (COLUMN, "effective_vs"),
    "column share, error of the reading (measured)": (COLUMN, "reading_error"),
    "column share, coherence (measured)": (COLUMN, "coherence"),
    "column share, effective_vs, error, coherence (measured)": (COLUMN, "effective_vs", "reading_error", "coherence"),
}
"""Of the wave itself, so no predictors of a sample that was not simulated."""

Fits = dict[tuple[int, int], VelocityPredictor]
"""Predictors by the places of content and seed, each without that seed."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("database")
    cells = read_cells(parser.parse_args().database)
    candidates = CANDIDATES | {name: columns for name, columns in MEASURED.items() if cells[columns[1]].notnull().any()}
    print("| features | score, m/s | less that of content alone (standard error) | in interval, % |")
    print("|---|---|---|---|")
    reference, _ = judge(cells, ())
    for name, columns in candidates.items():
        show(name, *judge(cells, columns), reference)


def read_cells(database: str) -> xr.Dataset:
    """Give the samples with a velocity at all contents where Vs scatters; NaN for those without a feature."""
    with open_campaign(database) as campaign:
        cells, analysis = campaign.to_xarray(), campaign.analyse()
        shares = [cement_shares(analysis, content) for content in cells["content"].to_numpy().tolist()]
    nothing, seeds = np.full(2, np.nan), cells["seed"].to_numpy().tolist()
    rows = np.array([[by_seed.get(seed, nothing) for by_seed in shares] for seed in seeds])
    cells = cells.assign({name: (("seed", "content"), rows[..., n]) for n, name in enumerate(CEMENT_FEATURES)})
    return cells.sel(content=cells["vs"].std("seed") > 1e-9)  # round-off


def features_of(cells: xr.Dataset, content: int, columns: tuple[str, ...]) -> np.ndarray:
    """Give the features of all seeds at a content, (seeds, k)."""
    return (
        np.array([cells[name].to_numpy()[:, content] for name in columns]).reshape(len(columns), cells.sizes["seed"]).T
    )


def fit_without_each(cells: xr.Dataset, columns: tuple[str, ...]) -> Fits:
    """Fit the predictors of one set of features."""
    fits = {}
    for content, vs in enumerate(cells["vs"].to_numpy().T):
        table = features_of(cells, content, columns)
        known = np.isfinite(vs) & np.isfinite(table).all(axis=1)
        for out in np.flatnonzero(known).tolist():
            others = known & (np.arange(vs.size) != out)
            fits[content, out] = VelocityPredictor.fit(table[others], vs[others])
    return fits


def judge(cells: xr.Dataset, columns: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Give interval score (m/s) and hit of each sample, (seed, content), NaN where there is none."""
    scores, hits = (np.full(cells["vs"].shape, np.nan) for _ in range(2))
    for (content, out), predictor in fit_without_each(cells, columns).items():
        vs = float(cells["vs"].to_numpy()[out, content])
        interval = predictor.predict(features_of(cells, content, columns)[out]).interval
        scores[out, content], hits[out, content] = interval.score(vs, 0.95), interval.contains(vs)
    return scores, hits


def show(name: str, scores: np.ndarray, hits: np.ndarray, reference: np.ndarray) -> None:
    """Print a row; samples of a seed share their cement, so that the standard error is that of the mean over seeds."""
    gains = np.nanmean(scores - reference, axis=1)
    print(
        f"| {name} | {np.nanmean(scores):.1f} | {gains.mean():+.1f} ({gains.std(ddof=1) / gains.size**0.5:.1f}) "
        f"| {100.0 * np.nanmean(hits):.1f} |"
    )


if __name__ == "__main__":
    main()
