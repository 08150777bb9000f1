"""Which features explain the scatter of Vs within a content: `python docs/reproduction/features.py CAMPAIGN.db ...`.

First the rank correlation of each feature with Vs and with the effective velocity. Then, for the first campaign,
predictions of each sample from other seeds, with the same features at every content. A negative difference to the
content alone is a gain.
"""

import argparse

import numpy as np
import xarray as xr
from scipy import stats

from calcidem.analysis.contact_network import NETWORK_FEATURES
from calcidem.analysis.packing_graph import FEATURES
from calcidem.analysis.predictor import VelocityPredictor
from calcidem.app.campaign.opened import open_campaign

SYMBOLS = {name: symbol for name, (symbol, _) in (NETWORK_FEATURES | FEATURES).items()}
C_DN, CONDUCTANCE, SHARE = "path_normalized_connectivity", "network_conductance", "network_cemented_share"
CANDIDATES: dict[str, tuple[str, ...]] = {
    "content alone": (),
    "C_d,n": (C_DN,),
    "S": (SHARE,),
    "G": (CONDUCTANCE,),
    "G, S": (CONDUCTANCE, SHARE),
    "G, C_d,n": (CONDUCTANCE, C_DN),
    "static_speed (statics)": ("static_speed",),
    "G, effective_vs (measured)": (CONDUCTANCE, "effective_vs"),
    "G, effective_vs, error, coherence (measured)": (CONDUCTANCE, "effective_vs", "reading_error", "coherence"),
}
"""Those measured are of the wave itself, so no predictors of a sample that was not simulated."""


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("databases", nargs="+")
    campaigns = [scattered_cells(database) for database in parser.parse_args().databases]
    print_correlations(campaigns)
    cells = campaigns[0]
    print("\n| features | score, m/s | less that of content alone (standard error) | in interval, % |")
    print("|---|---|---|---|")
    reference, _ = judge(cells, ())
    for name, columns in CANDIDATES.items():
        if all(bool(cells[column].notnull().any()) for column in columns):
            show(name, *judge(cells, columns), reference)


def scattered_cells(database: str) -> xr.Dataset:
    """Cells of the contents at which Vs scatters."""
    with open_campaign(database) as campaign:
        cells = campaign.to_xarray()
    return cells.sel(content=cells["vs"].std("seed") > 1e-9)  # round-off


def print_correlations(campaigns: list[xr.Dataset]) -> None:
    """Print the mean over contents of Spearman's coefficient; up to and above the contents of Stage I, of Vs."""
    names = [*SYMBOLS, "static_speed"]
    rows = {name: [value for cells in campaigns for value in correlations(cells, name)] for name in names}
    print("| feature |" + " with Vs | up to 0.66 % | above | with effective_vs |" * len(campaigns))
    print("|---|" + "---|---|---|---|" * len(campaigns))
    for name in sorted(names, key=lambda name: -np.nan_to_num(abs(rows[name][0]))):
        values = " | ".join("" if np.isnan(value) else f"{value:+.2f}" for value in rows[name])
        print(f"| {SYMBOLS.get(name, name)} | {values} |")


def correlations(cells: xr.Dataset, name: str) -> list[float]:
    """Mean rank correlation within a content: with Vs at all, low and high contents, with the effective velocity."""
    contents = cells["content"].to_numpy()
    found = {
        target: np.array(
            [_spearman(cells[name][:, column], cells[target][:, column]) for column in range(len(contents))]
        )
        for target in ("vs", "effective_vs")
    }
    low = contents <= 0.66
    groups = found["vs"], found["vs"][low], found["vs"][~low], found["effective_vs"]
    return [float(np.nanmean(group)) if np.isfinite(group).any() else np.nan for group in groups]


def _spearman(one: xr.DataArray, other: xr.DataArray) -> float:
    """Rank correlation; NaN without three samples, or for a constant."""
    x, y = (values.to_numpy().astype(float) for values in (one, other))
    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 3 or np.ptp(x[known]) == 0.0 or np.ptp(y[known]) == 0.0:
        return np.nan
    return float(stats.spearmanr(x[known], y[known]).statistic)


def judge(cells: xr.Dataset, columns: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Interval score (m/s) and hit of each sample, predicted from the other seeds, (seed, content), NaN without one."""
    scores, hits = (np.full(cells["vs"].shape, np.nan) for _ in range(2))
    for content, vs in enumerate(cells["vs"].to_numpy().T):
        table = np.array([cells[name].to_numpy()[:, content] for name in columns], dtype=float)
        table = table.reshape(len(columns), len(vs)).T
        known = np.isfinite(vs) & np.isfinite(table).all(axis=1)
        for out in np.flatnonzero(known).tolist():
            others = known & (np.arange(vs.size) != out)
            interval = VelocityPredictor.fit(table[others], vs[others]).predict(table[out]).interval
            scores[out, content], hits[out, content] = interval.score(vs[out], 0.95), interval.contains(vs[out])
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
