"""What longer steps, or steps of their own for slow disks, would save in a campaign.

    python benchmarks/limit/steps.py [examples/paper.toml] [--contents 0 2.55 9] [--run]

For a batch of samples: how far the bound of the step is below the true limit of the linearised sample (largest
eigenvalue, Lanczos), how far a tighter rigorous bound comes, how much the layers of strong damping cost, and which part
of the contact-steps could be left out if slow disks had steps twice or four times as long. With ``--run`` the batch is
computed with such steps, too: error of the signals, change of the velocities, CPU time, and how near the guards come.
Nothing here changes what campaigns compute. A minute on one core, ten with ``--run``.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import eigsh

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks" / "stiff")]

from newmark import springs

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.readout import overlaps, wall_overlaps
from calcidem.dem.engine.stability import critical_time_step, squared_frequencies
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.propagation import prepare_recorder
from calcidem.dem.wave.reading import read_section
from calcidem.dem.wave.recorder import Recorder

ROUNDS = 12  # of the tighter bound
REFERENCE = 1.0 / 8.0  # of the present step
RUNS = 3  # in turns, for the CPU time


def batch_of(experiment: Experiment, content: float, lanes: int) -> Recorder:
    """As many seeds as there are lanes, just before the pulse."""
    bonded = [experiment.ordering(seed).at(content).bonded for seed in range(1, lanes + 1)]
    return prepare_recorder(experiment, bonded, experiment.frequency(content), lanes, lambda: None)


def scaled_matrix(state: State, lane: int, damping: Floats) -> sparse.csr_array:
    """Stiffness over inertia, symmetric, with what damping does to the limit; disks that are held have empty rows."""
    grains = state.assembly.grains
    inverse = np.column_stack([grains.inverse_mass, grains.inverse_mass, grains.inverse_inertia]).astype(float)
    root = sparse.diags_array(np.sqrt((1.0 + damping)[:, None] * inverse).ravel())
    stiffness, _, _ = springs(state, lane)
    return sparse.csr_array(root @ stiffness @ root)


def true_limit(matrix: sparse.csr_array) -> float:
    """Critical step, s, from the largest eigenvalue."""
    return float(2.0 / np.sqrt(eigsh(matrix, k=1, which="LA", tol=1e-6, return_eigenvectors=False)[0]))


def tighter_limit(matrix: sparse.csr_array) -> float:
    """Rigorous bound of the critical step, s: Gershgorin's theorem for blocks, with weights that some rounds improve.

    Any positive weights x of the disks give ``omega^2 <= max_i (lambda_max(A_ii) + sum_j |A_ij| x_j / x_i)`` with the
    3 x 3 blocks of the matrix; the power method on the matrix of these norms finds good ones. Feingold & Varga (1962),
    doi:10.2140/pjm.1962.12.1241.
    """
    blocks = sparse.bsr_array(matrix, blocksize=(3, 3))
    count = len(blocks.indptr) - 1
    rows = np.repeat(np.arange(count), np.diff(blocks.indptr))
    own = rows == blocks.indices
    sizes = np.zeros(count)
    sizes[rows[own]] = np.linalg.eigvalsh(blocks.data[own])[:, -1]
    norms = np.linalg.norm(blocks.data[~own], ord=2, axis=(1, 2))
    between = sparse.csr_array((norms, (rows[~own], blocks.indices[~own])), shape=(count, count))
    weights, least = np.ones(count), np.inf
    for _ in range(ROUNDS):
        grown = sizes * weights + between @ weights
        least = min(least, float(np.max(grown / weights)))
        weights = grown / grown.max() + 1e-6  # nobody's becomes zero
    return float(2.0 / np.sqrt(least))


def describe_limits(state: State, content: float) -> tuple[float, float]:
    """Print what the first samples of a batch could have; return the least gains of the tighter bound.

    The second is that with heavier disks in the layers.
    """
    damping = state.assembly.grains.damping.astype(float)
    heavier, count = with_heavier_layers(state)
    gains = []
    for lane in range(3):
        matrix = scaled_matrix(state, lane, damping)
        true, bound = true_limit(matrix), float(state.critical_time_step[lane])
        began = process_time()
        tighter = tighter_limit(matrix)
        spent = process_time() - began
        interior = tighter_limit(scaled_matrix(heavier, lane, damping))
        gains.append((tighter / bound, interior / bound))
        print(
            f"| {content:g} | {lane + 1} | {bound:.3e} | {bound / true:.3f} | {tighter / true:.3f} | {tighter / bound:.3f} | "
            f"{interior / bound:.3f} | {count} | {spent:.2f} |"
        )
    return min(gain for gain, _ in gains), min(gain for _, gain in gains)


def describe_rates(state: State, content: float) -> None:
    """Print which part of the contacts lies between disks that are stable with longer steps, in groups of lanes."""
    squares = squared_frequencies(state.scene, state.assembly, state.features, None, None)
    # Disks whose own limit is ``longer`` times that of the whole sample; held ones have none.
    pairs, top = state.assembly.pairs, squares.max(axis=0)
    for longer in (2, 4):
        slow = longer**2 * squares <= top
        both = slow[pairs.first] & slow[pairs.second]
        groups = [both[:, :lanes].all(axis=1).mean() for lanes in (1, 8, both.shape[1])]
        saved = [(1.0 - 1.0 / longer) * share for share in groups]
        print(
            f"| {content:g} | {longer} | {slow[:, 0].mean():.2f} | "
            + " | ".join(f"{share:.2f}" for share in groups)
            + f" | {saved[0]:.2f} | {saved[-1]:.3f} |"
        )


@dataclass(frozen=True)
class Run:
    """What a batch gave with some step.

    Attributes
    ----------
    times, received
        (T,) s and (L, T) m/s, of each lane.
    velocities
        (L,) m/s, NaN where nothing can be read.
    seconds
        CPU time of the steps over the time that they cover, s/s.
    lowest
        Least present bound of the step during the run over that at its start: contacts stiffen under the pulse.
    """

    times: Floats
    received: Floats
    velocities: Floats
    seconds: float
    lowest: float


def with_heavier_layers(state: State) -> tuple[State, int]:
    """State whose layers do not set the step, and the number of disks that are heavier for it, by less than 2 times.

    Damping by 1 instead of 0.3 lowers the limit by 1.24. The wave has no business in these layers.
    """
    grains = state.assembly.grains
    squares = squared_frequencies(state.scene, state.assembly, state.features, None, None).max(axis=1)
    inside = grains.damping <= np.median(grains.damping)
    heavier = np.where(inside, 1.0, np.maximum(1.0, squares / squares[inside].max()))
    scaled = grains._replace(
        inverse_mass=(grains.inverse_mass / heavier).astype(grains.inverse_mass.dtype),
        inverse_inertia=(grains.inverse_inertia / heavier).astype(grains.inverse_inertia.dtype),
    )
    return replace(state, assembly=replace(state.assembly, grains=scaled)), int(np.count_nonzero(heavier > 1.0))


def run_batch(
    experiment: Experiment, content: float, lanes: int, longer: float, duration: float, *, heavier: bool = False
) -> Run:
    """Send the pulse with steps ``longer`` times the present ones."""
    recorder = batch_of(experiment, content, lanes)
    state, start = recorder.state, recorder.state.critical_time_step
    if heavier:
        state, _ = with_heavier_layers(state)
    recorder.state = replace(state, time_step=longer * state.time_step)
    recorder.stride = max(1, round(recorder.stride / longer))
    lowest, seconds, covered = np.inf, 0.0, 0.0
    while covered < duration:
        began = process_time()
        recorder.record_chunk()
        seconds += process_time() - began
        now = recorder.state
        covered = float(now.steps * now.time_step.max())
        if not now.features.linear:
            present = critical_time_step(now.scene, now.assembly, now.features, overlaps(now), wall_overlaps(now))
            lowest = min(lowest, float(np.min(present / start)))
    sections = [recorder.record_of(lane, "").section for lane in range(lanes)]
    found = [read_section(section, experiment.pick).peak for section in sections]
    return Run(
        sections[0].times,
        np.array([CubicSpline(one.times, one.received)(sections[0].times) for one in sections]),
        np.array([np.nan if value is None else value for value in found]),
        seconds / covered,
        lowest,
    )


def describe_runs(experiment: Experiment, content: float, lanes: int, gains: tuple[float, float]) -> None:
    """Print what present and longer steps give, against an eighth of the present one; CPU times are the least of some."""
    duration = measure(experiment, content, [1], lanes=lanes)[0].record.section.duration
    exact = run_batch(experiment, content, lanes, REFERENCE, duration)
    settings = ((1.0, False), (gains[0], False), (gains[1], True))
    rounds = [
        [run_batch(experiment, content, lanes, longer, duration, heavier=heavier) for longer, heavier in settings]
        for _ in range(RUNS)
    ]
    seconds = [min(run.seconds for run in runs) for runs in zip(*rounds, strict=True)]
    for (longer, heavier), run, spent in zip(settings, rounds[0], seconds, strict=True):
        inside = run.times <= exact.times[-1]
        errors, moved = [], np.abs(run.velocities / exact.velocities - 1.0)
        for own, true in zip(run.received, exact.received, strict=True):
            shifted = CubicSpline(exact.times, true)(run.times[inside])
            errors.append(np.linalg.norm(own[inside] - shifted) / np.linalg.norm(shifted))
        print(
            f"| {content:g} | {longer:.3f}{', heavier layers' * heavier} | {np.median(errors):.1e} | {np.nanmedian(moved):.1e} | "
            f"{np.nanmax(moved):.1e} | {spent / seconds[0]:.2f} | {run.lowest:.3f} |",
            flush=True,
        )


def main() -> None:
    """Print the tables."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("configuration", nargs="?", type=Path, default=ROOT / "examples" / "paper.toml")
    options.add_argument("--contents", type=float, nargs="+", default=[0.0, 2.55, 9.0])
    options.add_argument("--run", action="store_true", help="compute the batches, too")
    chosen = options.parse_args()
    configuration = load_configuration(chosen.configuration)
    experiment = configuration.experiment(provide_packing(configuration, None, lambda _: None))
    lanes = configuration.run.lanes
    states = {content: batch_of(experiment, content, lanes).state for content in chosen.contents}
    print("| calcite, % | seed | bound, s | over true | tighter over true | over bound | heavier layers | disks | s |")
    print("|---|---|---|---|---|---|---|---|---|")
    gains = {content: describe_limits(state, content) for content, state in states.items()}
    print("\n| calcite, % | longer | slow disks | contacts, 1 lane | 8 lanes | all lanes | saved, 1 lane | all lanes |")
    print("|---|---|---|---|---|---|---|---|")
    for content, state in states.items():
        describe_rates(state, content)
    if chosen.run:
        print(
            "\n| calcite, % | step over present | signal error | Vs, median | Vs, largest | CPU over present | lowest bound |"
        )
        print("|---|---|---|---|---|---|---|", flush=True)
        for content, gain in gains.items():
            describe_runs(experiment, content, lanes, gain)


if __name__ == "__main__":
    main()
