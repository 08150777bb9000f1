"""Whole cells of `paper-small-pulse` in YADE, with the same laws, beside calcidem's.

    python benchmarks/peers/whole_cells.py [--quick] [--contents .66 2.55 7] [--seed 1] [--figure FILE]

Three cemented samples, from the state before the pulse until the campaign's record ends: the signals of the receiver
and the velocities that the same reading takes from them. Laws are also left out one by one, and steps made smaller, so
that a difference has a name. Takes 40 minutes on one core; without YADE the program says so and ends.
"""

import argparse
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

from cells import (
    Ingredients,
    Signals,
    calcidem_signals,
    cell_of,
    export_cell,
    preset_experiment,
    read_signals,
    velocity_of,
)
from matplotlib.figure import Figure
from programs import HOW_TO, environment, find_yade
from scipy.interpolate import CubicSpline

from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.storage.records import NORMAL_95

PRESET = "paper-small-pulse"
CASES: tuple[tuple[str, Ingredients, tuple[int, ...]], ...] = (
    ("linear, as the preset", Ingredients("linear"), (1, 2)),
    ("linear, no damping", Ingredients("linear", damping=False), (1,)),
    ("finite, no damping, no slip", Ingredients("finite", damping=False, slip=False), (1,)),
    ("finite, slip alone", Ingredients("finite", damping=False), (1,)),
    ("finite, damping alone", Ingredients("finite", slip=False), (1,)),
    ("finite, slip and damping", Ingredients("finite"), (1, 2)),
    ("finite, slip and damping, no cement", Ingredients("finite", cement=False), (1, 4)),
)


@dataclass(frozen=True)
class Row:
    """One cell with one set of laws and one step, in both programs.

    Attributes
    ----------
    content, laws, finer
        Percent of calcite, the laws, and by how much the step is smaller than the campaign's.
    signal
        Difference of the receiver's signals over calcidem's, root mean square.
    own, peer
        Velocities, m/s; None where the record is no longer readable with these laws.
    stated
        95 % interval of the numerical error that the campaign states of this cell.
    """

    content: float
    laws: str
    finer: int
    signal: float
    own: float | None
    peer: float | None
    stated: float

    @property
    def departure(self) -> float | None:
        """Difference of the velocities over calcidem's."""
        return None if self.own is None or self.peer is None else self.peer / self.own - 1.0


def yade_signals(yade: str, exported: Path, step: float, stride: int) -> Signals:
    """What YADE records of an exported cell."""
    out = exported.with_suffix(".npy")
    command = [yade, "-n", "-x", "-j1", str(HERE / "yade_cell.py"), str(exported), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=exported.parent, env=environment())
    if not out.exists():
        raise RuntimeError(f"YADE ended without signals:\n{done.stdout[-1000:]}\n{done.stderr[-3000:]}")
    return read_signals(out, step, stride)


def compare(
    experiment: Experiment, content: float, seed: int, case: tuple[str, Ingredients, int], yade: str
) -> tuple[Row, Signals, Signals]:
    """One row, and the signals of calcidem and YADE."""
    laws, ingredients, finer = case
    (found,) = measure(experiment, content, [seed])
    duration = found.section.duration
    cell = cell_of(experiment, content, seed, ingredients, finer)
    own = calcidem_signals(cell, duration)
    with tempfile.TemporaryDirectory() as folder:
        exported = Path(folder) / "cell.npz"
        step, stride, _ = export_cell(cell, duration, exported)
        peer = yade_signals(yade, exported, step, stride)
    stated = np.nan if found.check.numerical_error is None else NORMAL_95 * found.check.numerical_error
    row = Row(content, laws, finer, difference(own, peer), velocity_of(cell, own), velocity_of(cell, peer), stated)
    return row, own, peer


def difference(own: Signals, other: Signals) -> float:
    """Difference of the receiver's signals over the first one's, root mean square over its times."""
    inside = own.times <= other.times[-1]
    shifted = CubicSpline(other.times, other.received)(own.times[inside]) - own.received[inside]
    return float(np.linalg.norm(shifted) / np.linalg.norm(own.received[inside]))


def draw(drawn: list[tuple[float, Signals, Signals]]) -> Figure:
    """Signals of both programs, sample below sample."""
    figure = Figure(figsize=(7.0, 2.1 * len(drawn)), layout="constrained")
    for axes, (content, own, peer) in zip(figure.subplots(len(drawn), 1, squeeze=False)[:, 0], drawn, strict=True):
        axes.plot(own.times * 1e3, own.received * 1e3, color="0.6", linewidth=4, label="calcidem")
        axes.plot(peer.times * 1e3, peer.received * 1e3, color="black", linewidth=1, label="YADE")
        axes.set_title(f"{content:g} % calcite", loc="left", fontsize="medium")
        axes.set_ylabel("velocity, mm/s")
    axes.set_xlabel("time, ms")
    figure.axes[0].legend(frameon=False)
    return figure


def line_of(row: Row) -> str:
    """Line of the table."""
    velocities = " | ".join("-" if value is None else f"{value:.2f}" for value in (row.own, row.peer))
    departure = "-" if row.departure is None else f"{100.0 * row.departure:+.3f}"
    return (
        f"| {row.content:g} | {row.laws} | 1/{row.finer} | {100.0 * row.signal:.3f} | {velocities} | {departure} | "
        f"{100.0 * row.stated:.2f} |"
    )


def main() -> int:
    """Print the table, draw the figure."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--contents", type=float, nargs="+", default=[0.66, 2.55, 7.0])
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--quick", action="store_true", help="only the preset's own laws, at its step")
    options.add_argument("--figure", type=Path, help="file for the signals of the preset's laws")
    chosen = options.parse_args()
    yade = find_yade()
    if yade is None:
        print(HOW_TO["yade"])
        return 1
    experiment = preset_experiment(PRESET)
    rows, drawn = [], []
    print("| calcite, % | laws | step | signal, % | Vs, calcidem | Vs, YADE | difference, % | stated, % |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for content in chosen.contents:
        for laws, ingredients, steps in CASES[:1] if chosen.quick else CASES:
            for finer in steps[:1] if chosen.quick else steps:
                row, own, peer = compare(experiment, content, chosen.seed, (laws, ingredients, finer), yade)
                rows.append(row)
                print(line_of(row), flush=True)
                if (laws, finer) == (CASES[0][0], 1):
                    drawn.append((content, own, peer))
    if chosen.figure:
        draw(drawn).savefig(chosen.figure, dpi=110)
    outside = [row for row in rows if row.departure is not None and abs(row.departure) > row.stated]
    return 1 if outside else 0


if __name__ == "__main__":
    sys.exit(main())
