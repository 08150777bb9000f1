"""Which of several parameters decides mean and scatter of Vs: total Sobol indices, with SALib.

    pip install SALib
    python examples/sobol_indices.py CONFIG.toml POINTS.db --bases 32

varies all RANGES together. Each point is a campaign of POINTS.db with the seeds and contents of CONFIG.toml; after a
stop the same command continues. There are (parameters + 2) times as many points as base points, a power of two. A total
index is the share of the variance that a parameter causes alone or together with others. Below some hundred base points
its 95 % interval (+-) is wide: a total index of 17 +- 30 says nothing.
"""

import argparse
from collections.abc import Mapping
from concurrent.futures import Executor, ProcessPoolExecutor

import numpy as np
from SALib.analyze import sobol as analysis
from SALib.sample import sobol as sampling

import calcidem

RANGES = {
    "sand.wave_stiffness_factor": (10.0, 22.0),
    "pattern.p_share": (0.55, 1.0),
    "pattern.cluster_area": (2.0e-6, 7.0e-6),  # m2
    "cement.bond_modulus": (4.0e10, 1.6e11),  # Pa
}

Ranges = Mapping[str, tuple[float, float]]


def problem(ranges: Ranges) -> dict[str, object]:
    """Parameters as SALib takes them."""
    return {"num_vars": len(ranges), "names": list(ranges), "bounds": [list(ends) for ends in ranges.values()]}


def compute(configuration: str, database: str, ranges: Ranges, bases: int, pool: Executor | None = None) -> np.ndarray:
    """Vs (point, seed, content) in m/s at the points of a scrambled Sobol sequence, NaN if missing."""
    found = []
    points = sampling.sample(problem(ranges), bases, calc_second_order=False, seed=1)
    for number, values in enumerate(points.tolist()):
        changes = {"campaign.name": f"point {number}", "run.store_sections": False}
        changes |= dict(zip(ranges, values, strict=True))
        with calcidem.run(configuration, db=database, set=changes, progress=False, executor=pool) as campaign:
            found.append(campaign.vs().transpose("seed", "content").to_numpy())
    return np.array(found)


def total_indices(ranges: Ranges, output: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Total indices and half-widths of their 95 % intervals, (parameters,), from an output (points,), NaN if missing.

    Base points with a missing value are left out.
    """
    bases = output.reshape(-1, len(ranges) + 2)
    whole = bases[np.isfinite(bases).all(axis=1)]
    if len(whole) < 4 or np.ptp(whole) <= 1e-12 * np.abs(whole).max():  # nothing varies
        return np.full(len(ranges), np.nan), np.full(len(ranges), np.nan)
    found = analysis.analyze(problem(ranges), whole.ravel(), calc_second_order=False, num_resamples=1000, seed=1)
    return found["ST"], found["ST_conf"]


def main() -> None:
    """Print a row for each content, output and parameter."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("configuration")
    parser.add_argument("database")
    parser.add_argument("--bases", type=int, default=32)
    options = parser.parse_args()
    with ProcessPoolExecutor() as pool:
        vs = compute(options.configuration, options.database, RANGES, options.bases, pool)
    mean, deviation = np.nanmean(vs, axis=1), np.nanstd(vs, axis=1, ddof=1)
    contents = calcidem.load_configuration(options.configuration).campaign.contents
    for column, content in enumerate(sorted(contents)):
        for name, output in {"mean": mean, "sd / mean": deviation / mean}.items():
            for parameter, total, half in zip(RANGES, *total_indices(RANGES, output[:, column]), strict=True):
                print(f"{content:g} %, {name}, {parameter}: {total:.2f} +- {half:.2f}")


if __name__ == "__main__":
    main()
