"""What both velocities say about a sample: against its static stiffness, another receiver, the other side and pulse.

    python benchmarks/velocity/run.py [--preset paper] [--packings 11 12] [--seeds 301 16] [--frequency 1] [--one-side]

prints two tables over the contents of the packings (docs/velocity.md). Each sample is measured as configured, by a
receiver as wide as the box, with the pulse reversed, and sent from the other side. S is the static speed. *side* is
half the variance of the logarithm of the ratio to the wave from the other side. *r* is the correlation of logarithms
over seeds, pooled within content and packing; *repeatability* the standard deviation of the logarithm of two receivers'
ratio, over the root of 2; *within* the share of differences within 1.96 stated errors. If effective
velocities are means of both sides (`wave.both_sides`), the other side is no judge; ``--one-side`` makes them of one.
"""

import argparse
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.presets import preset_text
from calcidem.app.config.reader import read_configuration
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.check import check_content, from_other_side, reading_of, with_check
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, interpret
from calcidem.dem.wave.propagation import send_waves
from calcidem.dem.wave.section import Section
from calcidem.dem.wave.static_speed import static_speed

LANES = 16
SIDES = ("as configured", "wide receiver", "reversed", "other side")


def main() -> None:
    """Measure all samples, and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--packings", type=int, nargs="+", default=(11, 12))
    parser.add_argument("--seeds", type=int, nargs=2, default=(301, 16), metavar=("FIRST", "COUNT"))
    parser.add_argument("--contents", type=float, nargs="+", default=(0.11, 0.66, 2.55, 5.0, 9.0))
    parser.add_argument("--frequency", type=float, default=1.0, help="factor of the frequencies")
    parser.add_argument("--one-side", action="store_true", help="effective velocities from one side")
    given = parser.parse_args()
    seeds = range(given.seeds[0], given.seeds[0] + given.seeds[1])
    found: dict[float, list[Samples]] = defaultdict(list)
    for packing in given.packings:
        experiment = prepared(given.preset, packing, given.frequency)
        experiment = experiment.with_wave(both_sides=experiment.wave.both_sides and not given.one_side)
        for content in given.contents:
            found[content].append(Samples(experiment, content, seeds))
    for name in ("vs", "effective_vs"):
        print(f"\n`{name}`\n\n| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
        for content, parts in found.items():
            print(f"| {content:g} | {' | '.join(row(parts, name))} |")
        print(f"| all | {' | '.join(row([one for parts in found.values() for one in parts], name))} |", flush=True)


def prepared(preset: str, packing: int, factor: float) -> Experiment:
    """Experiment of a preset on another packing, with its frequencies times a factor."""
    values = tomllib.loads(preset_text(preset))
    values["packing"]["seed"] = packing
    configuration = read_configuration(values)
    experiment = configuration.experiment(provide_packing(configuration, None))
    return replace(experiment, frequencies=lambda _, content: factor * experiment.frequency(content))


class Samples:
    """Samples of one content and packing, measured in all manners."""

    def __init__(self, experiment: Experiment, content: float, seeds: Sequence[int]) -> None:
        """Measure them."""
        placed = [experiment.ordering(seed).at(content) for seed in seeds]
        check = check_content(experiment, content, LANES)
        own = with_check(experiment, check)
        wide = own.with_wave(receiver_half_width=0.49 * own.packing.height)
        other = replace(own, packing=own.packing.mirrored())
        self.static = np.array([static_speed(experiment, cement.bonded).speed for cement in placed])
        self.measured: dict[str, list[Measurement]] = {}
        for name, settings, sign in zip(SIDES, (own, wide, own, other), (1.0, 1.0, -1.0, 1.0), strict=True):

            def sections(usual: Experiment, sign: float = sign) -> list[Section]:
                return send_waves(
                    usual,
                    [cement.bonded for cement in placed],
                    experiment.frequency(content),
                    lanes=LANES,
                    signs=[sign] * len(placed),
                )

            measured = [
                interpret(experiment, Measurement(seed, content, cement, section, check))
                for seed, cement, section in zip(seeds, placed, sections(settings), strict=True)
            ]
            if experiment.wave.both_sides:
                there = [reading_of(section, experiment) for section in sections(from_other_side(settings))]
                measured = [
                    replace(one, other_wave=other and other.wave) for one, other in zip(measured, there, strict=True)
                ]
            self.measured[name] = measured

    def values(self, side: str, name: str) -> Floats:
        """Velocities, m/s; NaN without one."""
        return np.array([getattr(one, name) or np.nan for one in self.measured[side]])

    def errors(self, side: str, name: str) -> Floats:
        """Their relative standard errors."""
        if name == "effective_vs":
            return np.array([one.effective_error or np.nan for one in self.measured[side]])
        return np.array(
            [
                np.nan
                if one.vs is None or one.reading is None
                else np.sqrt(one.reading.error**2 + one.check.numerical_error**2 + one.check.pulse_effect**2)
                for one in self.measured[side]
            ]
        )


HEADER = (
    *("content %", "velocities", "r", "median over S", "sd over S %", "sd of S %", "stated error %"),
    *("stated / sd, variances", "repeatability %", "side / sd, variances", *(f"within: {side}" for side in SIDES[1:])),
)


def row(parts: Sequence[Samples], name: str) -> Iterator[str]:
    """Columns of a table."""
    values = [one.values(SIDES[0], name) for one in parts]
    ratio = np.concatenate([value / one.static for value, one in zip(values, parts, strict=True)])
    own, static = ([centred(np.log(one)) for one in lists] for lists in (values, [one.static for one in parts]))
    left, right = np.concatenate(own), np.concatenate(static)
    known = np.isfinite(left)
    errors = np.concatenate([one.errors(SIDES[0], name) for one in parts])
    stated = float(np.nanmean(errors**2))
    yield f"{known.sum()} of {known.size}"
    yield f"{np.corrcoef(left[known], right[known])[0, 1]:.2f}"
    yield f"{np.nanmedian(ratio):.3f}"
    yield f"{100 * np.nanstd(left - right):.1f}"
    yield f"{100 * np.std(right):.1f}"
    yield f"{100 * np.sqrt(stated):.1f}"
    yield f"{stated / np.nanvar(left):.2f}"
    wide = np.concatenate(
        [centred(np.log(v / one.values("wide receiver", name))) for v, one in zip(values, parts, strict=True)]
    )
    yield f"{100 * np.sqrt(np.nanmean(wide**2) / 2.0):.1f}"
    other = [centred(np.log(v / one.values("other side", name))) for v, one in zip(values, parts, strict=True)]
    yield f"{np.nanvar(np.concatenate(other)) / 2.0 / np.nanvar(left):.2f}"
    for side in SIDES[1:]:
        apart = [centred(np.log(v / one.values(side, name))) for v, one in zip(values, parts, strict=True)]
        both = [np.hypot(one.errors(SIDES[0], name), one.errors(side, name)) for one in parts]
        off, bound = np.abs(np.concatenate(apart)), 1.96 * np.concatenate(both)
        seen = np.isfinite(off)
        yield f"{100 * np.mean(off[seen] <= bound[seen]):.0f} %"


def centred(values: Floats) -> Floats:
    """Values less their median."""
    return values - np.nanmedian(values)


if __name__ == "__main__":
    main()
