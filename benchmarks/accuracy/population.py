"""Expected error and bound of cells of a packing that took no part in setting them, against a finer finite run.

    python benchmarks/accuracy/population.py [--packing 32] [--seeds 3201 8] [--contents 9 5 2.55 0.66]
    python benchmarks/accuracy/population.py --loud 5 --config calcidem/app/config/presets/paper-locked.toml --contents 0.66 2.55 5

prints, for each regime and amplitude, the rank correlation of expected and true error and how many are within their bound.
"""

import argparse
import tomllib
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import read_configuration
from calcidem.dem.wave.measurement import measure_all

_FILE = Path(__file__).resolve().parents[2] / "examples" / "paper-small-pulse.toml"
_CONTENTS = (0.0, 0.11, 0.23, 0.34, 0.45, 0.55, 0.66, 1.24, 1.88, 2.55, 3.17, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)  # percent
_PLAN = {1e-3: ("linear", "finite"), 3e-3: ("linear",), 3e-2: ("finite",)}  # m/s
_FINER = {"regime": "finite", "precision": "float64", "step_fraction": 0.2, "samples_per_period": 400}


def main() -> None:
    """Measure, and print after each content what is known until then."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--packing", type=int, default=32)
    parser.add_argument("--seeds", type=int, nargs=2, default=(3201, 8), metavar=("FIRST", "COUNT"))
    parser.add_argument("--contents", type=float, nargs="+", default=_CONTENTS)
    parser.add_argument("--config", type=Path, default=_FILE, metavar="FILE")
    parser.add_argument("--loud", type=float, metavar="M_PER_S", help="only the finite regime at this amplitude")
    given = parser.parse_args()
    plan = {given.loud: ("finite",)} if given.loud else _PLAN
    values = tomllib.loads(given.config.read_text())
    values["packing"]["seed"] = given.packing
    configuration = read_configuration(values)
    experiment = configuration.experiment(provide_packing(configuration, None, print, lambda: None))
    found: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    for content in given.contents:
        first, count = given.seeds
        seeds = range(first, first + (count if content else 1))
        for amplitude, regimes in plan.items():
            loud = replace(experiment, wave=replace(experiment.wave, amplitude=amplitude))
            exact = measure_all(replace(loud, wave=replace(loud.wave, **_FINER)), content, seeds)
            for regime in regimes:
                cells = measure_all(replace(loud, wave=replace(loud.wave, regime=regime)), content, seeds)
                for cell, other in zip(cells, exact, strict=True):
                    if cell.vs and other.vs and cell.error_bound:
                        row = abs(cell.vs / other.vs - 1.0), cell.expected_error, cell.error_bound
                        for group in ("all", regime, f"{regime}, {amplitude:g} m/s"):
                            found[group].append(row)
        print(f"until {content:g} %")
        for group, rows in found.items():
            error, expected, bound = np.array(rows).T
            rank = spearmanr(error, expected).statistic if len(rows) > 2 else np.nan  # two always agree
            medians = " | ".join(f"{np.median(row):.1e}" for row in (error, expected, bound))
            print(
                f"| {group} | {len(rows)} | {rank:.2f} | {medians} | {error.max():.1e} | {np.sum(error <= bound)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
