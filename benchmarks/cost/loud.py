"""What a pulse of 5 m/s costs beside a small one in the finite regime.

    python benchmarks/cost/loud.py

Preset `paper-locked`, eight samples at each of three contents, amplitudes of 1 mm/s and 5 m/s in turns, median of three
rounds: CPU seconds of the batch, steps of a record, and how many samples were sent once more with half the step.
"""

import time
import tomllib
from dataclasses import replace

import numpy as np

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.presets import preset_text
from calcidem.app.config.reader import read_configuration
from calcidem.dem.wave.measurement import measure_all

_CONTENTS, _AMPLITUDES, _SEEDS, _ROUNDS = (0.66, 2.55, 5.0), (1e-3, 5.0), range(1, 9), 3


def main() -> None:
    """Print a row for each content."""
    configuration = read_configuration(tomllib.loads(preset_text("paper-locked")))
    experiment = configuration.experiment(provide_packing(configuration, None, print, lambda: None))
    pulses = [replace(experiment, wave=replace(experiment.wave, amplitude=value)) for value in _AMPLITUDES]
    for pulse in pulses:
        measure_all(pulse, _CONTENTS[0], _SEEDS)  # compiles
    print(
        "| content % | 1 mm/s: s | steps | again | 5 m/s: s | steps | again | times |\n|---|---|---|---|---|---|---|---|"
    )
    for content in _CONTENTS:
        rounds = []
        for _ in range(_ROUNDS):
            found = []
            for pulse in pulses:
                began = time.process_time()
                cells = measure_all(pulse, content, _SEEDS)
                steps = np.mean([cell.record.section.duration / cell.record.time_step for cell in cells])
                found += [time.process_time() - began, steps, sum(bool(cell.record.retry) for cell in cells)]
            rounds.append(found)
        row = np.median(np.array(rounds), axis=0)
        shown = (f"{row[0]:.2f}", f"{row[1]:.0f}", f"{row[2]:.0f}", f"{row[3]:.2f}", f"{row[4]:.0f}", f"{row[5]:.0f}")
        print(f"| {content:g} | {' | '.join(shown)} | {row[3] / row[0]:.1f} |", flush=True)


if __name__ == "__main__":
    main()
