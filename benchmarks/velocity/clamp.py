"""Which clamp K of the strip the sections themselves prefer, over the K that the fit assumes.

    python benchmarks/velocity/clamp.py [--preset paper] [--packings 15 16] [--seeds 601 16] [--frequency 1]

prints for each content the K with the least misfit of all samples together, its 90 % interval by resampling the seeds, and
the medians of the effective velocity with this K and with one larger by 15 %, over that with the assumed one.
"""

import argparse

import numpy as np
from run import LANES, prepared

from calcidem.dem.wave.propagation import send_waves
from calcidem.dem.wave.section import fit_velocity, fitness

FACTORS = np.arange(0.0, 2.01, 0.1)


def main() -> None:
    """Fit all sections with each K, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--packings", type=int, nargs="+", default=(15, 16))
    parser.add_argument("--seeds", type=int, nargs=2, default=(601, LANES), metavar=("FIRST", "COUNT"))
    parser.add_argument("--contents", type=float, nargs="+", default=(0.0, 0.11, 0.66, 2.55, 5.0, 9.0))
    parser.add_argument("--frequency", type=float, default=1.0, help="factor of the frequencies")
    given = parser.parse_args()
    generator = np.random.default_rng(1)
    print("| packing | content % | best K | 90 % | velocity with it | with 1.15 K |\n|---|---|---|---|---|---|")
    for packing in given.packings:
        experiment = prepared(given.preset, packing, given.frequency).with_wave(law="linear")
        for content in given.contents:
            seeds = range(given.seeds[0], given.seeds[0] + (given.seeds[1] if content > 0.0 else 1))
            bonded = [experiment.ordering(seed).at(content).bonded for seed in seeds]
            sections = send_waves(experiment, bonded, experiment.frequency(content), lanes=LANES)
            velocity, misfit = np.empty((2, len(FACTORS), len(sections)))
            for row, factor in enumerate(FACTORS):
                clamp = factor * experiment.clamp
                found = [fit_velocity(section, clamp) or np.nan for section in sections]
                velocity[row] = found
                misfit[row] = [
                    1.0 - fitness(section, clamp, np.array([one]))[0]
                    for section, one in zip(sections, found, strict=True)
                ]
            drawn = generator.integers(0, len(sections), (200, len(sections)))
            best, *interval = (
                FACTORS[misfit.sum(axis=1).argmin()],
                *np.percentile(FACTORS[misfit[:, drawn].sum(axis=2).argmin(axis=0)], (5, 95)),
            )
            median = np.median(velocity, axis=1)
            ratios = np.interp((best, 1.15), FACTORS, median) / np.interp(1.0, FACTORS, median)
            low, high = interval
            print(
                f"| {packing} | {content:g} | {best:.1f} | {low:.1f} to {high:.1f} | {ratios[0]:.2f} | {ratios[1]:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
