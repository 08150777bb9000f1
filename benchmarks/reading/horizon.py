"""Whether a record that is cut where its reading is decided gives the same bits: real cells of a preset.

    python benchmarks/reading/horizon.py [--preset paper] [--seeds 32] [--first 9001]

Each cell is recorded to its end, read, cut at the horizon of the peak that was read, and read again. A cell without a
velocity is cut at a half and at three quarters, where nothing but `Verdict.TOO_SHORT` or the same verdict may come out.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from calcidem.app.campaign.packing import kept_packing
from calcidem.app.config import presets
from calcidem.app.config.reader import load_configuration
from calcidem.dem.wave.measurement import measure_all
from calcidem.dem.wave.reading import PickRule, Reading, find_candidates, read_section
from calcidem.dem.wave.section import Section
from calcidem.ends import Verdict

_LANES = 16


def cut(section: Section, samples: int) -> Section:
    """The first samples of a section."""
    return replace(section, across=section.across[:samples], along=section.along[:samples])


def values(reading: Reading | Verdict) -> tuple[object, ...]:
    """What users see of a reading."""
    if isinstance(reading, Verdict):
        return (reading,)
    return reading.verdict, reading.peak, reading.first_arrival, reading.error, reading.path, reading.path_error


def differs(section: Section, rule: PickRule) -> bool:
    """Whether a shorter record has another reading than the whole one."""
    whole = read_section(section, rule)
    if isinstance(whole, Verdict):
        shorter = [read_section(cut(section, int(part * len(section.across))), rule) for part in (0.5, 0.75)]
        return any(each not in {whole, Verdict.TOO_SHORT, Verdict.SILENT} for each in shorter)
    chosen = next(c for c in find_candidates(section, rule.smoothing) if c.index == whole.index)
    samples = int(chosen.decided / section.sampling_interval) + 1
    return values(read_section(cut(section, samples), rule)) != values(whole)


def main() -> None:
    """Record, cut, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--seeds", type=int, default=32)
    parser.add_argument("--first", type=int, default=9001)
    chosen = parser.parse_args()
    configuration = load_configuration(Path(presets.__file__).parent / f"{chosen.preset}.toml")
    packing = kept_packing(configuration.packing_hash, print)
    if packing is None:
        parser.error(f"no packing is kept for {chosen.preset}: run it with --packing-only")
    experiment = replace(configuration.experiment(packing), early_stop=False)
    count = read = different = 0
    for content in (each for each in configuration.campaign.contents if each > 0.0):
        seeds = range(chosen.first, chosen.first + chosen.seeds)
        for found in measure_all(experiment, content, seeds, lanes=_LANES):
            count += 1
            read += found.vs is not None
            different += differs(found.section, experiment.pick)
        print(f"{content:g} %: {count} records so far, {read} read, {different} differ", flush=True)


if __name__ == "__main__":
    main()
