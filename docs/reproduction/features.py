"""Which features explain the scatter of Vs within a content: `python docs/reproduction/features.py CAMPAIGN.db ...`.

First the rank correlation of each feature with Vs and with the effective velocity. Then laws of the first campaign,
judged on seeds left out and on the other campaigns. Then predictions of each of its samples from other seeds, with the
same features at every content. A negative difference to the content alone is a gain.
"""

import argparse

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import sparse, stats
from scipy.sparse.csgraph import connected_components, maximum_flow

from calcidem.analysis.fits import VelocityPredictor, fit_power_law, leave_one_seed_out
from calcidem.analysis.packing_graph import FEATURES, NETWORK_FEATURES, PackingGraph
from calcidem.app.campaign.opened import open_campaign

SYMBOLS = {name: symbol for name, (symbol, _) in (NETWORK_FEATURES | FEATURES).items()}
C_DN, CONDUCTANCE, SHARE = "path_normalized_connectivity", "network_conductance", "network_cemented_share"
LOGARITHM = "logarithm of the conductance"
CANDIDATES: dict[str, tuple[str, ...]] = {
    "content alone": (),
    "C_d,n": (C_DN,),
    "S": (SHARE,),
    "log G": (LOGARITHM,),
    "log G, S": (LOGARITHM, SHARE),
    "log G, C_d,n": (LOGARITHM, C_DN),
    "static_speed (statics)": ("static_speed",),
    "log G, effective_vs (measured)": (LOGARITHM, "effective_vs"),
    "log G, effective_vs, error, coherence (measured)": (LOGARITHM, "effective_vs", "reading_error", "coherence"),
}
"""Those measured are of the wave itself, so no predictors of a sample that was not simulated."""


def minimum_cut(graph: PackingGraph, kinds: NDArray[np.uint8]) -> float:
    """Fewest bonds that part the side walls; by SciPy in 10 ms, where networkx takes 30 ms to 3 s."""
    first, second = graph.graph.pairs[kinds > 0].T
    left, right = (np.flatnonzero(graph.side == side) for side in (-1, 1))
    begin, count = graph.graph.grain_count, graph.graph.grain_count + 2
    rows = np.concatenate([first, second, np.full(len(left), begin), right])
    columns = np.concatenate([second, first, left, np.full(len(right), begin + 1)])
    capacity = np.where(np.arange(len(rows)) < 2 * len(first), 1, len(first)).astype(np.int32)
    ways = sparse.csr_array((capacity, (rows, columns)), shape=(count, count))
    return float(maximum_flow(ways, begin, begin + 1).flow_value)


def chain_length(graph: PackingGraph, kinds: NDArray[np.uint8]) -> float:
    """Mean number of grains of a cemented force chain: strong contacts (Radjai et al. 1998) joined by cement."""
    pairs = graph.graph.pairs[(kinds > 0) & graph.strong]
    shape = (graph.graph.grain_count,) * 2
    _, piece = connected_components(sparse.coo_array((np.ones(len(pairs)), pairs.T), shape=shape), directed=False)
    grains = np.bincount(piece)
    return float(grains[grains > 1].mean()) if len(pairs) else 0.0


def chain_orientation(graph: PackingGraph, kinds: NDArray[np.uint8]) -> float:
    """Mean cos(2 angle to the path) of the cemented strong contacts."""
    chosen = graph.cosine[(kinds > 0) & graph.strong]
    return float(chosen.mean()) if len(chosen) else np.nan


def cemented_force(graph: PackingGraph, kinds: NDArray[np.uint8]) -> float:
    """Mean force of the cemented contacts over that of all; Hertz forces of the packing, which cement preserves."""
    packing, (first, second) = graph.packing, graph.graph.pairs.T
    one, other = packing.radius[first], packing.radius[second]
    apart = np.hypot(packing.x[first] - packing.x[second], packing.y[first] - packing.y[second])
    force = np.sqrt(one * other / (one + other)) * np.maximum(one + other - apart, 0.0) ** 1.5
    return float(force[kinds > 0].mean() / force.mean()) if kinds.any() else np.nan


LEFT_OUT = {
    "minimum cut of the bonds": minimum_cut,
    "length of cemented force chains": chain_length,
    "their orientation": chain_orientation,
    "force of cemented contacts": cemented_force,
}
"""Features that explain little, so that no campaign stores them."""


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("databases", nargs="+")
    campaigns = [scattered_cells(database) for database in parser.parse_args().databases]
    print_correlations(campaigns)
    print_left_out(parser.parse_args().databases[0])
    print_laws(campaigns)
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
    cells[LOGARITHM] = np.log(cells[CONDUCTANCE])
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


def print_left_out(database: str) -> None:
    """Print the same for features that are not stored, with the coefficient over all contents before it."""
    print("\n| left out | over all contents | within a content |\n|---|---|---|")
    for name, (overall, within) in left_out_correlations(database).items():
        print(f"| {name} | {overall:+.2f} | {within:+.2f} |")


def left_out_correlations(database: str) -> dict[str, tuple[float, float]]:
    """Spearman's coefficient with Vs over all contents and its mean within one, of each feature left out."""
    with open_campaign(database) as campaign:
        table = campaign.analyse(features=LEFT_OUT).own_table.sel(content=slice(0.01, None))
    return {
        name: (_spearman(table[name], table["vs"]), correlations(table.assign(effective_vs=table["vs"]), name)[0])
        for name in LEFT_OUT
    }


def print_laws(campaigns: list[xr.Dataset]) -> None:
    """Print Vs = a x^b + c, and the rms errors on seeds left out and on the samples of the other campaigns."""
    first, *others = campaigns
    print("\n| Vs from | law | rms error on unseen seeds, m/s |" + " on another packing |" * len(others))
    print("|---|---|---|" + "---|" * len(others))
    for name in (CONDUCTANCE, C_DN):
        x, vs, seeds = samples_of(first, name)
        fit, check = fit_power_law(x, vs), leave_one_seed_out(x, vs, seeds)
        errors = [vs - fit.predict(x) for x, vs, _ in (samples_of(cells, name) for cells in others)]
        row = "".join(f" {np.sqrt(np.mean(error**2)):.0f} |" for error in errors)
        law = f"{fit.a:.0f} {SYMBOLS[name]}^{fit.b:.2f} {fit.c:+.0f}"
        print(f"| {SYMBOLS[name]} | {law} | {check.root_mean_square_error:.0f} |{row}")
    count = first["vs"].notnull().sum("seed")
    apart = (first["vs"] - first["vs"].mean("seed")) * count / (count - 1.0)  # from the mean of the others
    errors = [apart, *(cells["vs"] - first["vs"].mean("seed") for cells in others)]
    row = " | ".join(f"{float(np.sqrt((error**2).mean())):.0f}" for error in errors)
    print(f"| content alone | mean of the content | {row} |")


def samples_of(cells: xr.Dataset, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Feature, Vs and seed of all samples that have them."""
    x, vs = (cells[one].to_numpy().astype(float) for one in (name, "vs"))
    known = np.isfinite(x) & np.isfinite(vs)
    return x[known], vs[known], np.broadcast_to(cells["seed"].to_numpy()[:, None], vs.shape)[known]


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
