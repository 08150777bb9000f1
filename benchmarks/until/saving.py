"""What seeds that are added content by content save against as many at each, on the velocities of the preset `paper`.

    python benchmarks/until/saving.py

Each content draws its seeds from its 116 stored velocities, as many as it asks for (bootstrap, five campaigns).
"""

import numpy as np

import calcidem
from calcidem.analysis.planning import next_seed_count

BEGIN, MOST, CAMPAIGNS = 16, 4000, 5


def seeds_needed(velocities: np.ndarray, mean: float, sd: float | None) -> int:
    """Seeds with which a content ends."""
    count = BEGIN
    while (found := next_seed_count(velocities[:count], MOST, mean=mean, sd=sd)) > count:
        count = found
    return count


def main() -> None:
    """Print a line for each wish."""
    cells = calcidem.load_paper_campaign()
    vs, seconds = cells.vs.to_numpy(), cells.seconds.to_numpy()
    cost = np.nanmean(seconds, axis=0)
    for mean, sd in ((0.05, None), (0.02, None), (0.05, 0.2), (0.02, 0.1)):
        sizes, savings = [], []
        for number in range(CAMPAIGNS):
            draws = np.random.default_rng(number)
            counts = np.array([seeds_needed(draws.choice(column, MOST), mean, sd) for column in vs.T])
            sizes.append(counts.sum())
            savings.append((1 - counts.mean() / counts.max(), 1 - counts @ cost / (counts.max() * cost.sum())))
        fewer, cheaper = np.mean(savings, axis=0)
        print(f"mean {mean}, sd {sd}: {np.mean(sizes):.0f} cells, {fewer:.0%} fewer, {cheaper:.0%} less computing time")


if __name__ == "__main__":
    main()
