"""The linear regime against the finite one on small packings near isostaticity.

    python benchmarks/accuracy/isostatic.py [--seeds 1 2 3]

Packings of about 150 disks at 1, 5 and 50 kPa, with friction 0.2, 0.5 and 1 while packing, bare and with 1 % of calcite.
Prints, for each packing seed, how many cells both regimes can read, the finite one with half the step and 400 samples a
period; in how many of them the linear regime gives a velocity, how many of these lie within its bound, and the worst
error; how many it refuses for their numerical error, and the worst error of what was read there.
"""

import argparse
from dataclasses import replace
from itertools import product

from calcidem.app.studies.stability.scenes import Packed, experiment_of_packing, small_packing
from calcidem.dem.wave.measurement import LARGEST_BOUND, Measurement, measure

_STRESSES, _FRICTIONS, _CONTENTS = (1e3, 5e3, 5e4), (0.2, 0.5, 1.0), (0.0, 1.0)  # Pa, -, percent
_FINER = {"regime": "finite", "step_fraction": 0.4, "samples_per_period": 400}


def main() -> None:
    """Print a row for each packing seed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=(1, 2, 3))
    titles = (
        "packing seed",
        "both read",
        "linear gives Vs",
        "within its bound",
        "worst error",
        "refused",
        "worst of these",
    )
    print(f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}")
    for seed in parser.parse_args().seeds:
        found = [pair for pair in _pairs(seed) if all(_read(cell) for cell in pair)]
        errors = [(abs(_velocity(linear) / _velocity(finite) - 1.0), linear) for linear, finite in found]
        given = [(error, cell) for error, cell in errors if cell.vs]
        refused = [error for error, cell in errors if not cell.vs]
        within = sum(error <= cell.result.error.bound for error, cell in given if cell.result.error)
        worst = (f"{max(chosen, default=0.0):.1%}" for chosen in ([error for error, _ in given], refused))
        row = (seed, len(found), len(given), within, next(worst), len(refused), next(worst))
        print(f"| {' | '.join(map(str, row))} |", flush=True)


def _pairs(seed: int) -> list[tuple[Measurement, Measurement]]:
    """Cells of a packing seed in the linear and in the finite regime."""
    pairs = []
    for stress, friction in product(_STRESSES, _FRICTIONS):
        packing = small_packing(stress, friction, seed)
        for content in _CONTENTS:
            linear = experiment_of_packing(packing, Packed(stress, friction, content, "linear", seed))
            finite = replace(linear, wave=replace(linear.wave, **_FINER))
            pairs.append((measure(linear, content, [seed])[0], measure(finite, content, [seed])[0]))
    return pairs


def _read(cell: Measurement) -> bool:
    """Whether a top was found, whatever its error may be."""
    return bool(cell.vs) or cell.result.reason.startswith(_TOO_INEXACT)


def _velocity(cell: Measurement) -> float:
    """Vs, m/s, given or not."""
    return cell.vs or cell.result.reading.peak  # type: ignore[union-attr,return-value]


_TOO_INEXACT = f"the numerical error may be above {LARGEST_BOUND:.0%}".replace("%", " %")


if __name__ == "__main__":
    main()
