"""How often a reading of sections with a known delay is wrong, how often it refuses, and what its standard errors are worth.

    python benchmarks/reading/judge.py [--drawn 65] [--lattices 1001 1150] [--strips 1]

Draws sections of a seed (sections.py), or computes those of some seeds: of lattices (lattice_sections.py), of elastic
strips (strips.py). *Wrong* is a velocity off by more than 10 % and by more than twice its standard error, of all
sections; *refused* is no velocity, of those that are readable (`Section.readable`). A reading that states no standard
error is wrong beyond 10 %.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from lattice_sections import sections_of_seed
from section import Section
from sections import drawn_sections
from strips import strips_of_seed

from calcidem.dem.kernels.layout import Flags, Floats
from calcidem.dem.wave import reading, section

Reading = Callable[[Section], tuple[float | None, float]]
"""From a section to a velocity, m/s, None if refused, and its relative standard error, NaN if none is stated."""

WRONG = 0.1  # of the velocity
CLASSES = 10  # of the standard error, each with as many sections
BOUNDS = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.12, 0.15, 0.2, 0.3, np.inf)
_PATHS = (0.0, 0.7, 1.0, 1.5, 2.5, np.inf)  # wavelengths
_APERTURES = (0.0, 0.25, 0.5, 1.0, 2.0, np.inf)  # wavelengths
_RULE = reading.PickRule(largest_error=1.0)  # what a smaller bound refuses is in the last table
_SAMPLES_PER_PERIOD = 40


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """What a reading made of some sections.

    Attributes
    ----------
    error
        (N,) relative error of the velocity; NaN where refused.
    stated
        (N,) its relative standard error; NaN where none is stated.
    readable
        (N,) see `Section.readable`.
    kind
        (N,) of the sections.
    path, aperture
        (N,) wavelengths.
    """

    error: Floats
    stated: Floats
    readable: Flags
    kind: np.ndarray
    path: Floats
    aperture: Floats

    @property
    def read(self) -> Flags:
        """(N,) whether there is a velocity."""
        return np.isfinite(self.error)

    @property
    def wrong(self) -> Flags:
        """(N,) whether a velocity is wrong."""
        off = np.abs(self.error)
        return np.asarray((off > WRONG) & ~(off <= 2.0 * self.stated))

    def refuse_above(self, bound: float) -> "Judgement":
        """The same with velocities refused whose standard error is larger."""
        kept = ~(self.stated > bound)
        parts = (self.readable, self.kind, self.path, self.aperture)
        return Judgement(np.where(kept, self.error, np.nan), self.stated, *parts)


def judge(sections: Sequence[Section], reading: Reading) -> Judgement:
    """Read all sections."""
    found = [reading(one) for one in sections]
    velocity = np.array([np.nan if value is None else value for value, _ in found])
    return Judgement(
        error=velocity / np.array([one.velocity for one in sections]) - 1.0,
        stated=np.array([stated for _, stated in found]),
        readable=np.array([one.readable for one in sections]),
        kind=np.array([one.kind for one in sections]),
        path=np.array([one.wavelengths for one in sections]),
        aperture=np.array([one.aperture for one in sections]),
    )


def recorded(known: Section, samples_per_period: int = _SAMPLES_PER_PERIOD) -> section.Section:
    """A section as a sample would have recorded it: sampled no finer, and quantised."""
    interval = float(known.times[1] - known.times[0])
    stride = max(1, int(1.0 / (known.frequency * interval * samples_per_period) + 1e-9))
    across, along = (
        section.quantise(np.ascontiguousarray(motion.T[stride - 1 :: stride]), known.amplitude)
        for motion in (known.across, known.along)
    )
    return section.Section(
        sampling_interval=stride * interval,
        start_time=float(known.times[stride - 1]),
        frequency=known.frequency,
        amplitude=known.amplitude,
        places=tuple((known.places * known.distance).tolist()),
        across=across,
        along=along,
    )


def read_section(known: Section) -> tuple[float | None, float]:
    """Velocity to the receiver, m/s, and standard error by the reading of calcidem.dem.wave."""
    found = reading.read_section(recorded(known), known.clamp, _RULE)
    return (None, np.nan) if isinstance(found, reading.Verdict) else (found.peak, found.error)


def read_without_bias(known: Section) -> tuple[float | None, float]:
    """The same divided by the bias that it states."""
    found = reading.read_section(recorded(known), known.clamp, _RULE)
    if isinstance(found, reading.Verdict) or found.peak is None:
        return None, np.nan
    return found.peak / (1.0 + found.bias), found.error


def read_effective(known: Section) -> tuple[float | None, float]:
    """Effective velocity of the sample and its standard error."""
    found = reading.read_section(recorded(known), known.clamp, _RULE)
    return (None, np.nan) if isinstance(found, reading.Verdict) else (found.wave.velocity, found.wave.error)


def counts_of(judgement: Judgement, some: Flags) -> tuple[str, ...]:
    """Number, readable, wrong and refused (%), and rms error (%) of some sections."""
    readable = some & judgement.readable
    off = judgement.error[some & judgement.read]
    return (
        f"{some.sum()}",
        f"{100.0 * judgement.readable[some].mean():.0f}",
        f"{100.0 * judgement.wrong[some].mean():.1f}",
        f"{100.0 * (~judgement.read[readable]).mean():.1f}" if readable.any() else "-",
        f"{100.0 * np.sqrt(np.mean(off**2)):.1f}" if len(off) else "-",
        f"{100.0 * np.median(off):+.1f}" if len(off) else "-",
    )


def print_table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table in Markdown."""
    print(f"\n| {' | '.join(titles)} |\n|{'---|' * len(titles)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")


def print_counts(judgement: Judgement, kinds: Sequence[str]) -> None:
    """Wrong and refused by kind, and by path and aperture."""
    titles = ("sections", "readable %", "wrong %", "refused %", "rms error %", "median %")
    everything = np.ones(len(judgement.kind), dtype=bool)
    rows = [(kind, *counts_of(judgement, judgement.kind == kind)) for kind in kinds]
    print_table(("kind", *titles), [*rows, ("all", *counts_of(judgement, everything))])
    for name, values, ends in (("path", judgement.path, _PATHS), ("half-aperture", judgement.aperture, _APERTURES)):
        classes = [(low, high, (values >= low) & (values < high)) for low, high in pairwise(ends)]
        rows = [(f"{low:g} to {high:g}", *counts_of(judgement, some)) for low, high, some in classes if some.any()]
        if len(rows) > 1:
            print_table((f"{name}, wavelengths", *titles), rows)


def print_errors(judgement: Judgement) -> None:
    """Stated standard error against rms error in classes, and wrong and refused against a bound."""
    known = np.flatnonzero(judgement.read & np.isfinite(judgement.stated))
    if not len(known):
        print("\nThe reading states no standard error.")
        return
    rows = []
    for some in np.array_split(known[np.argsort(judgement.stated[known], kind="stable")], CLASSES):
        stated, off = judgement.stated[some], np.abs(judgement.error[some])
        claimed, rms = np.sqrt(np.mean(stated**2)), np.sqrt(np.mean(off**2))
        within, median = np.mean(off <= 2.0 * stated), np.median(off) / 0.6745
        rows.append(
            (
                f"{len(some)}",
                f"{100.0 * stated.min():.1f} to {100.0 * stated.max():.1f}",
                *(f"{100.0 * value:.2f}" for value in (claimed, rms, median)),
                f"{claimed / rms:.2f}",
                f"{100.0 * within:.1f}",
            )
        )
    titles = ("sections", "standard error %", "its rms %", "rms error %", "robust %", "stated / rms", "within twice %")
    print_table(titles, rows)
    rows = []
    for bound in BOUNDS:
        left = judgement.refuse_above(bound)
        rows.append(
            (
                f"{100.0 * bound:g}",
                f"{100.0 * left.wrong.mean():.2f}",
                f"{100.0 * (~left.read[left.readable]).mean():.2f}",
                f"{100.0 * left.read.mean():.1f}",
            )
        )
    print_table(("refused above %", "wrong %", "refused %", "read of all %"), rows)


_READINGS = (("receiver", read_section), ("without bias", read_without_bias), ("effective", read_effective))


def main() -> None:
    """Judge the reading as it is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drawn", type=int, nargs="*", default=[], metavar="SEED")
    parser.add_argument("--lattices", type=int, nargs=2, metavar=("FIRST", "LAST"))
    parser.add_argument("--strips", type=int, nargs="*", default=[], metavar="SEED")
    chosen = parser.parse_args()
    sets: dict[str, list[Section]] = {}
    if chosen.drawn:
        sets["drawn"] = drawn_sections(chosen.drawn)
    if chosen.lattices:
        first, last = chosen.lattices
        sets["lattices"] = [one for seed in range(first, last + 1) for one in sections_of_seed(seed)]
    if chosen.strips:
        sets["strips"] = [one for seed in chosen.strips for one in strips_of_seed(seed)]
    for name, sections in sets.items():
        print(f"\n{name}: {len(sections)} sections")
        for title, read in _READINGS:
            judgement = judge(sections, read)
            print(f"\n{title}")
            print_counts(judgement, tuple(dict.fromkeys(one.kind for one in sections)))
            print_errors(judgement)


if __name__ == "__main__":
    main()
