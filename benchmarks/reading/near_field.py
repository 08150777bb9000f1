"""Velocity over the way in periods of the pulse, where it is so short that P and S wave run together.

    python benchmarks/reading/near_field.py [--packing 2]

Sends pulses of lower and lower frequency through samples of the preset `paper-small-pulse` with another packing, 8 seeds a content,
without the rule of the shortest way (`pick.fewest_periods`), and prints Vs over that at the frequency of the preset and
over the static speed of the same sample.
"""

import argparse
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import read_configuration
from calcidem.dem.wave.measurement import measure_all
from calcidem.dem.wave.static_speed import static_speed

_FILE = Path(__file__).resolve().parents[2] / "examples" / "paper-small-pulse.toml"
_CONTENTS = (0.23, 0.66, 1.24, 2.55, 5.0, 9.0)  # percent
_WAYS = (0.3, 0.36, 0.42, 0.48, 0.6, 0.8)  # periods, at the velocity of the preset's frequency
_SEEDS = range(901, 909)


def main() -> None:
    """Print a row for each content and frequency at which a sample is read."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--packing", type=int, default=2)
    values = tomllib.loads(_FILE.read_text())
    values["packing"]["seed"] = parser.parse_args().packing
    configuration = read_configuration(values)
    experiment = configuration.experiment(provide_packing(configuration, None, print, lambda: None))
    experiment = replace(experiment, pick=replace(experiment.pick, fewest_periods=0.0))
    titles = (
        "content %",
        "kHz",
        "read",
        "periods on the way",
        "Vs over that of the preset",
        "median",
        "over the static speed",
    )
    print(f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}")
    for content in _CONTENTS:
        usual = measure_all(experiment, content, _SEEDS)
        velocity = np.array([cell.vs or np.nan for cell in usual])
        static = np.array(
            [static_speed(experiment, experiment.ordering(seed).at(content).bonded).speed for seed in _SEEDS]
        )
        for way in _WAYS:
            frequency = way * np.nanmedian(velocity) / experiment.distance
            slower = replace(experiment, frequencies=((0.0, 100.0), (frequency, frequency)))
            cells = measure_all(slower, content, _SEEDS)
            found = np.array([cell.vs or np.nan for cell in cells])
            periods = [cell.frequency * cell.picks.peak.travel_time for cell in cells if cell.vs]
            if not periods:
                continue
            ratio, speed = found / velocity, found / static
            row = (
                f"{content:g}",
                f"{frequency / 1e3:.1f}",
                f"{len(periods)}",
                f"{min(periods):.2f} to {max(periods):.2f}",
                f"{np.nanmin(ratio):.2f} to {np.nanmax(ratio):.2f}",
                f"{np.nanmedian(ratio):.2f}",
                f"{np.nanmedian(speed):.2f}",
            )
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
