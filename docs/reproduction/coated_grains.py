"""Clusters as coated grains: whatever touches a grain whose centre lies in the circle is cemented to it.

The rule of calcidem cements the contacts whose contact point lies in the circle. The paper speaks of grains "coated
with" calcite, which can be read in this way, too; it makes the same circle hold more contacts.
`python docs/reproduction/coated_grains.py` measures both with the same circles, the calcite of a cluster in proportion
to its contacts.
"""

import argparse
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from calcidem.analysis.normality import skewness
from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem.sample.cement import CementOrdering
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure_all

CONTENTS = (1.24, 2.55, 5.0, 9.0)


def coat_grains(experiment: Experiment, seed: int) -> CementOrdering:
    """Order of the cement, with the circles of the seed but all contacts of the grains inside."""
    own, packing = experiment.ordering(seed), experiment.packing
    count = len(own.centres)
    grains = cKDTree(np.column_stack([packing.x, packing.y]))
    inside = grains.query_ball_point(own.centres, experiment.cement_rule.cluster_diameter / 2.0)
    first = np.full(len(packing.x), count)
    for cluster in range(count - 1, -1, -1):
        first[inside[cluster]] = cluster
    first_cluster = first[packing.pairs].min(axis=1)
    # Over the first clusters, before they overlap much, contacts gained are contacts of a cluster.
    early = max(1, count // 20)
    growth = np.count_nonzero(first_cluster < early) / np.count_nonzero(own.first_cluster < early)
    return replace(own, first_cluster=first_cluster, c_content=own.c_content * growth)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("configuration", nargs="?", default="examples/paper-small-pulse.toml")
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--receiver", type=float, default=0.01, help="half-width of the receiver, m")
    options = parser.parse_args()
    loaded = load_configuration(options.configuration)
    loaded = replace(loaded, wave=replace(loaded.wave, receiver_half_width=options.receiver))
    experiment = loaded.experiment(provide_packing(loaded, None, lambda _: None))
    orderings = {"contacts in the circle": experiment.ordering, "coated grains": partial(coat_grains, experiment)}
    print(
        "| content % | clusters | mean, m/s | sd, m/s | sd / mean | skewness |", "|---|---|---|---|---|---|", sep="\n"
    )
    for content in CONTENTS:
        for name, ordering in orderings.items():
            cells = measure_all(experiment, content, range(1, options.seeds + 1), ordering=ordering)
            vs = np.array([cell.vs for cell in cells if cell.vs is not None])
            scatter = vs.std(ddof=1)
            row = f"{vs.mean():.0f} | {scatter:.0f} | {scatter / vs.mean():.3f} | {skewness(vs):.2f}"
            print(f"| {content:g} | {name} | {row} |", flush=True)


if __name__ == "__main__":
    main()
