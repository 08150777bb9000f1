"""How much of the scatter of Vs comes from the P contacts, and how much from the clusters.

`python docs/reproduction/crossed_patterns.py [CONFIG] [--seeds 8]` combines the P contacts of each of some seeds with
the clusters of each, measures all combinations, and divides the variance of Vs between the two.
"""

import argparse
from dataclasses import replace
from functools import partial

import numpy as np
from variance import variance_parts

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem.sample.cement import CementOrdering
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure_all

HEADER = "| content % | P x clusters | mean, m/s | sd, m/s | by P | by clusters | by both together |"


def cross_patterns(experiment: Experiment, seed: int) -> CementOrdering:
    """Order of the cement of seed 1000 a + b: the P contacts of seed a and the clusters of seed b."""
    first, second = divmod(seed, 1000)
    own = experiment.ordering(second)
    if first == second:
        return own
    other = experiment.ordering(first)
    return replace(own, p_rank=other.p_rank, p_content=other.p_content)


def complete_part(table: np.ndarray) -> np.ndarray:
    """Table without the rows and columns that have gaps, samples without velocity; those with most gaps go first."""
    while (gaps := ~np.isfinite(table)).any():
        rows, columns = gaps.sum(axis=1), gaps.sum(axis=0)
        along = int(columns.max() > rows.max())
        table = np.delete(table, (rows, columns)[along].argmax(), axis=along)
    return table


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("configuration", nargs="?", default="examples/paper-small-pulse.toml")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--contents", type=float, nargs="+", default=[0.66, 1.24, 2.55, 5.0, 9.0])
    options = parser.parse_args()
    configuration = load_configuration(options.configuration)
    experiment = configuration.experiment(provide_packing(configuration, None, lambda _: None))
    ordering = partial(cross_patterns, experiment)
    numbers = range(1, options.seeds + 1)
    print(HEADER, "|---|---|---|---|---|---|---|", sep="\n", flush=True)
    for content in options.contents:
        seeds = [1000 * p + c for p in numbers for c in numbers]
        cells = measure_all(experiment, content, seeds, ordering=ordering)
        table = np.array([cell.vs for cell in cells], dtype=float).reshape(len(numbers), -1)
        complete = complete_part(table)
        parts = variance_parts(complete)
        shares = [f"{deviation:.1f}" for deviation in parts.deviations]
        row = [
            f"{content:g}",
            f"{complete.shape[0]} x {complete.shape[1]}",
            f"{parts.mean:.0f}",
            f"{parts.total**0.5:.1f}",
            *shares,
        ]
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
