"""Cost of the guards of a running wave: with and without, taking turns, and the time spent in them.

python benchmarks/stiff/guards.py examples/paper-small-pulse.toml [ROUNDS]
"""

import sys
from dataclasses import replace
from pathlib import Path
from statistics import median
from time import process_time

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.wave import recorder
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.guards import problems_of
from calcidem.dem.wave.measurement import measure

CASES = ((0.0, "linear"), (0.66, "linear"), (5.0, "linear"), (5.0, "finite"))
SEEDS = range(1, 9)


class Clock:
    """Guards that know how long they took."""

    spent = 0.0

    def guarded(self, state: State, amplitude: float, overlap: float) -> list[str]:
        """Do what the guards do."""
        began = process_time()
        found = problems_of(state, amplitude, overlap)
        self.spent += process_time() - began
        return found

    def blind(self, state: State, _amplitude: float, _overlap: float) -> list[str]:
        """Look at nothing."""
        return [""] * state.features.lanes


def seconds(experiment: Experiment, content: float) -> float:
    """Processor time of a batch, s."""
    began = process_time()
    measure(experiment, content, SEEDS)
    return process_time() - began


def main() -> None:
    """Print a line for each case."""
    configuration = load_configuration(Path(sys.argv[1]))
    rounds = int(sys.argv[2]) if len(sys.argv) > 2 else 9  # noqa: PLR2004 - script, configuration, rounds
    own = configuration.experiment(provide_packing(configuration, None, print))
    clock = Clock()
    print("| content % | regime | batch, s | time in the guards | with over without, median | middle half |")
    print("|---|---|---|---|---|---|")
    for content, regime in CASES:
        experiment = replace(own, wave=replace(own.wave, regime=regime))
        seconds(experiment, content)
        ratios, shares, times = [], [], []
        for _ in range(rounds):
            recorder.problems_of = clock.guarded
            clock.spent = 0.0
            guarded = seconds(experiment, content)
            shares.append(clock.spent / guarded)
            recorder.problems_of = clock.blind
            ratios.append(guarded / seconds(experiment, content))
            times.append(guarded)
        low, high = sorted(ratios)[rounds // 4], sorted(ratios)[-1 - rounds // 4]
        print(
            f"| {content:g} | {regime} | {median(times):.2f} | {100 * median(shares):.2f} % | {median(ratios):.4f} "
            f"| {low:.3f} to {high:.3f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
