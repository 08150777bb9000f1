"""Stated numerical errors of cells of a packing that took no part in setting them, against an eighth of the step.

    python benchmarks/accuracy/population.py [--packing 32] [--seeds 3201 8] [--contents 9 5 2.55 0.66] [--amplitude 5]

prints, after each content, how many of the errors of Vs and of the effective velocity are within 1.96 standard errors.
The reference has the finite law, double precision and ten times the samples.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import change_configuration
from calcidem.app.studies.accuracy import CellError, covered_share
from calcidem.dem.wave.measurement import measure

_FILE = Path(__file__).resolve().parents[2] / "calcidem" / "app" / "config" / "presets" / "paper.toml"
_CONTENTS = (0.0, 0.11, 0.23, 0.34, 0.45, 0.55, 0.66, 1.24, 1.88, 2.55, 3.17, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)  # percent


def main() -> None:
    """Measure, and print after each content what is known until then."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--packing", type=int, default=32)
    parser.add_argument("--seeds", type=int, nargs=2, default=(3201, 8), metavar=("FIRST", "COUNT"))
    parser.add_argument("--contents", type=float, nargs="+", default=_CONTENTS)
    parser.add_argument("--config", type=Path, default=_FILE, metavar="FILE")
    parser.add_argument("--amplitude", type=float, metavar="M_PER_S", help="by default that of the file")
    given = parser.parse_args()
    values = {"packing.seed": given.packing, "campaign.contents": list(given.contents)}
    values |= {"wave.amplitude": given.amplitude} if given.amplitude else {}
    configuration = change_configuration(given.config, values)
    experiment = configuration.experiment(provide_packing(configuration, None))
    wave, lanes = experiment.wave, configuration.run.lanes
    finer = replace(experiment, is_checked=False).with_wave(
        law="finite",
        precision="float64",
        step_fraction=wave.step_fraction / 8.0,
        samples_per_period=10 * wave.samples_per_period,
    )
    found: list[CellError] = []
    print("| content, % | law | cells | of Vs: median | worst | stated | within | of effective Vs: the same |")
    for content in given.contents:
        first, count = given.seeds
        seeds = range(first, first + (count if content else 1))  # without cement all samples are the same
        cells = measure(experiment, content, seeds, lanes=lanes)
        exact = measure(finer, content, seeds)
        new = [CellError.compare("", *pair) for pair in zip(cells, exact, strict=True)]
        found += new
        for name, rows in ((f"{content:g}", new), ("all", found)):
            columns = []
            for error in ("vs_deviation", "effective_deviation"):
                errors, own = ([getattr(row, field) for row in rows] for field in (error, "stated"))
                known = np.abs([one for one in errors if one is not None] or [np.nan])
                middle = np.nanmedian([np.nan if one is None else one for one in own])
                columns += [f"{one:.1e}" for one in (np.median(known), known.max(), middle)]
                columns.append(f"{covered_share(errors, own):.0%}")
            print(f"| {name} | {cells[0].check.law} | {len(rows)} | {' | '.join(columns)} |", flush=True)


if __name__ == "__main__":
    main()
