"""Preview of a run: checks and estimates without computing."""

import os
import shutil
import subprocess
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from time import thread_time

import numpy as np

from calcidem.analysis.intervals import mean_half_width
from calcidem.analysis.velocity import FEWEST_GRAINS
from calcidem.app.campaign.cells import SeedDemand, batches_of, planned_cells, time_of_wave
from calcidem.app.campaign.launch import Launch, find_mpirun, launcher_options
from calcidem.app.campaign.packing import CACHE_VARIABLE, cache_folder, check_path, kept_packing, stored_packing
from calcidem.app.config.checks import (
    can_make_files,
    check_against_packing,
    cutoff_estimate,
    disks_in_box,
    limit_of_mean_disks,
)
from calcidem.app.config.examples import calibration_note
from calcidem.app.config.schema import Configuration, choose_campaign
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import WAVELENGTHS, expected_speed
from calcidem.ends import CellStatus
from calcidem.storage.files import filesystem_type, is_network_filesystem
from calcidem.storage.records import CellKey, Selection
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.store import Store
from calcidem.sweep.ranks import LAUNCHER_VARIABLES, available_cores, mpi_library_version, refuse_ranks_off_linux
from calcidem.sweep.schedule import Batch, Cell, LaunchError
from calcidem.wording import duration, listening

SECONDS_WHERE_MEASURED = 2.7e-3  # of `_seconds_of_arithmetic`


@dataclass(frozen=True, slots=True)
class _ExpectedCost:
    """Cost of cells, each number within a factor of two."""

    seconds: float
    """Time on one core of this machine with compiled kernels and the packing, s."""
    packing_seconds: float
    """Time for the packing, s."""
    memory: float
    """Bytes of each computing process."""
    disk: float
    """Bytes of the database and the NetCDF file."""


def preview_lines(configuration: Configuration, ranks: int | None = None) -> Iterator[str]:
    """Check a configuration against its database, its packing, if any, and this machine, and describe the run.

    MPI ``ranks`` are started for a moment; None for a run without them.

    `ConfigurationError` if the packing cannot hold the planned cement; `StoreError` if the database cannot be read, or
    has another campaign of that name, or this one under another name.
    """
    plan, address = configuration.campaign, Address.parse(configuration.database)
    is_new = address.path is not None and not address.path.exists()
    own = [CellKey(*cell) for cell in planned_cells(configuration)]
    part = "" if configuration.run.part is None else f", {len(own)} of them in part {configuration.run.part}"
    part += "" if plan.until is None else f" to begin with (up to {plan.most_seeds} seeds each)"
    packing, settled, widths = None, set[CellKey](), dict[float, float]()
    with nullcontext() if is_new else Store(configuration.database, read_only=True) as store:
        if store is not None and choose_campaign(store, configuration):
            if plan.until is not None:
                own = [CellKey(*cell) for cell in SeedDemand.of_store(store, plan).cells]
            statuses = store.statuses(Selection({key.seed for key in own}))  # a content may be new
            settled = {key for key in own if statuses.get(key, CellStatus.PENDING) is not CellStatus.PENDING}
            widths = _expected_half_widths(store, configuration)
            if store.packing_indices():
                packing = stored_packing(store.packing(), configuration.packing_hash)
    with listening(lambda _: None):  # a check has its own sentence on the packing
        packing = packing or kept_packing(configuration.packing_hash)
    left = batches_of(configuration, [(key.seed, key.content) for key in own if key not in settled])
    cells = len(plan.seed_numbers) * len(plan.contents)
    yield (
        f"Campaign {plan.name}: {len(plan.seed_numbers)} seeds x {len(plan.contents)} contents = {cells} cells{part}; "
        f"{len(settled)} are finished, {sum(len(batch.cells) for batch in left)} samples are to be computed."
    )
    if widths:
        best, worst = min(widths, key=widths.__getitem__), max(widths, key=widths.__getitem__)
        yield (
            f"All {len(plan.seed_numbers)} seeds give the mean of Vs to +- {widths[best]:.1f} m/s ({best:g} %) to "
            f"+- {widths[worst]:.1f} m/s ({worst:g} %), 95 %; campaign.until adds seeds until it is narrow enough."
        )
    yield f"Database: {address}{', new' if is_new else ''}"
    if note := calibration_note(configuration):
        yield note
    doubts = [] if packing is None else check_against_packing(configuration, packing)
    speeds = _expected_speeds(configuration, packing, plan.contents)
    contents = sorted({batch.cells[0][1] for batch in left})
    checks = [c for c in contents if packing is None or not check_path(configuration, packing, c).exists()]
    yield from _cost_lines(configuration, speeds, left, checks, is_packed=packing is not None)
    yield from _machine_warnings(address.path)
    if ranks is not None and ranks != 1:
        yield _describe_ranks(Launch((), ranks).ranks)
    if packing is None:
        yield (
            "Packing: not made yet. Make it with 'calcidem run CONFIG --packing-only', then check again for contents"
            "\n  that it cannot hold or that are hard to read."
        )
        return
    for doubt in doubts:
        yield f"Warning: {doubt}."
    yield f"Packing: {len(packing.radius)} disks; they hold these contents and this wave."
    yield from _chosen_frequencies(configuration, packing)
    for doubt in wave_doubts(configuration, packing, speeds):
        yield f"Warning: {doubt}."


def _expected_half_widths(store: Store, configuration: Configuration) -> dict[float, float]:
    """Half-width (m/s) of the mean's 95 % interval with all planned seeds, for contents with known scatter."""
    plan, columns = configuration.campaign, store.table(("content", "vs"))
    vs = {content: columns["vs"][columns["content"] == content].astype(float) for content in plan.contents}
    known = {content: values[np.isfinite(values)] for content, values in vs.items()}
    return {
        content: mean_half_width(float(np.std(values, ddof=1)), max(len(plan.seed_numbers), 2), 0.95)
        for content, values in known.items()
        if len(values) >= 3 and content > 0.0  # a deviation of fewer has no meaning; no scatter without cement
    }


def _cost_lines(
    configuration: Configuration,
    speeds: Mapping[float, float],
    batches: Sequence[Batch[Cell]],
    checks: Collection[float],
    *,
    is_packed: bool,
) -> Iterator[str]:
    """Time, memory and disk that the remaining cells, and the checks of these contents, need."""
    if not batches:
        return
    cost, cores = _expected_cost(configuration, speeds, batches, checks), available_cores()
    busy = max(1, min(cores, len(batches)))
    # A loose lattice (porosity 0.33, 1,440 disks of two sizes) took 20 times as long as a packing.
    loose = "" if configuration.packing_draw.file is None else " (20 times as long if its disks are loose)"
    packing = "" if is_packed else f", after {duration(max(1.0, cost.packing_seconds))} for the packing{loose}"
    all_cores = "" if busy == 1 else f", {duration(max(1.0, cost.seconds / busy))} with --ranks 0 on {cores} cores"
    yield f"Time: about {duration(max(1.0, cost.seconds))} on one core{all_cores}{packing}, kernels compiled."
    memory, free = _available_memory(), _free_space(configuration)
    of_memory = "" if memory is None else f", {memory / 1e9:.1f} GB are available"
    of_disk = "" if free is None else f", {free / 1e9:.1f} GB are free"
    yield (
        f"Memory: about {cost.memory / 1e9:.2f} GB a process{of_memory}. "
        f"Disk: about {cost.disk / 1e6:.1f} MB{of_disk}. These are right within a factor of two."
    )
    if memory is not None and cost.memory > memory:
        yield "Warning: packing.width: one process needs more memory than there is; make the box smaller."
    elif memory is not None and busy * cost.memory > memory:
        enough = int(memory / cost.memory)
        yield f"Warning: run.lanes: memory suffices for {enough} of {cores} cores; use fewer ranks or lanes."
    if free is not None and cost.disk > free:
        yield "Warning: run.output: results need more space than is free; free some space, or give another folder."


def _machine_warnings(database: Path | None) -> Iterator[str]:
    """Warnings about the places of database and caches; the database is None on a server."""
    from calcidem.dem.kernels.steps import advance_steps  # noqa: PLC0415 - takes a second to import

    if database is not None and is_network_filesystem(database):
        yield (
            f"Warning: run.database: {filesystem_type(database)} is shared between machines, so each commit is slow; a "
            "local disk is faster, if you copy the database back."
        )
    if not can_make_files(cache_folder()):
        yield (
            f"Warning: {CACHE_VARIABLE}: {cache_folder()} cannot be written, so each campaign makes its packing again; "
            "give a folder in which you may write."
        )
    kernels = getattr(getattr(advance_steps, "stats", None), "cache_path", None)
    if kernels is not None and not can_make_files(Path(kernels)):
        yield (
            f"Warning: NUMBA_CACHE_DIR: {kernels} cannot be written, so every process compiles its kernels; give "
            "a folder in which you may write."
        )
    elif kernels is not None and is_network_filesystem(Path(kernels)):
        yield f"Warning: NUMBA_CACHE_DIR: {kernels} is shared between machines; set it to a disk of the node."


def _describe_ranks(ranks: int) -> str:
    """Start MPI ranks as a run does, and say whether they communicate."""
    try:
        refuse_ranks_off_linux()
        mpirun = find_mpirun()
        done = subprocess.run(  # noqa: S603 - our own program
            [
                mpirun,
                *launcher_options(mpirun, ranks),
                sys.executable,
                "-c",
                # Said by one of them, since lines of several may come in pieces.
                "from mpi4py import MPI; found = MPI.COMM_WORLD.gather(1); found and print(sum(found), 'ranks')",
            ],
            check=True,
            capture_output=True,
            text=True,
            timeout=120.0,  # s; a network file system without cache is slow
            env={name: value for name, value in os.environ.items() if name not in LAUNCHER_VARIABLES},
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        return f"Warning: --ranks {ranks}: they did not start within 120 s; {available_cores()} cores can be used."
    except (LaunchError, OSError, subprocess.SubprocessError) as error:
        written = [line for line in str(getattr(error, "stderr", None) or "").splitlines() if line.strip(" -")]
        return f"Warning: --ranks {ranks}: {written[-1].strip() if written else error}."
    if f"{ranks} ranks" not in done.stdout.splitlines():
        return (
            f"Warning: --ranks {ranks}: {mpirun} starts them, but they do not communicate; set MPIRUN to the launcher "
            "of the MPI library that mpi4py loads."
        )
    return f"Ranks: {mpirun} starts {ranks}, and they communicate ({mpi_library_version()})."


def _chosen_frequencies(configuration: Configuration, packing: Packing) -> Iterator[str]:
    """Frequencies that `wave.frequency = "auto"` chooses."""
    if configuration.excitation.table is None:
        experiment, contents = configuration.experiment(packing), sorted(configuration.campaign.contents)
        chosen = (f"{experiment.frequency(content) / 1e3:g} kHz at {content:g} %" for content in contents)
        yield f'Frequency: {", ".join(chosen)}, by wave.frequency = "auto".'


def wave_doubts(
    configuration: Configuration, packing: Packing, speeds: Mapping[float, float] | None = None
) -> Iterator[str]:
    """Contents whose wavelength does not suit the path or the grains.

    ``speeds`` are the expected ones, m/s, by content; without them only the least and the largest content are judged.
    """
    experiment, diameter = configuration.experiment(packing), 2.0 * float(np.mean(packing.radius))
    if speeds is None:
        ends = {min(configuration.campaign.contents), max(configuration.campaign.contents)}
        speeds = _expected_speeds(configuration, packing, ends)
    for content, speed in sorted(speeds.items()):
        frequency = experiment.frequency(content)
        waves, grains = frequency * experiment.distance / speed, speed / (frequency * diameter)
        # On a path of less than one wavelength P and S wave arrive as one; shorter waves than six grains are scattered.
        if waves >= 1.0 and grains >= FEWEST_GRAINS:
            continue
        why = (
            f"{waves:.1f} wavelengths on the path, so that P and S wave arrive as one"
            if waves < 1.0
            else f"{grains:.1f} grains in a wavelength, which samples scatter"
        )
        longest = speed / (FEWEST_GRAINS * diameter)
        cure = (
            f"wave.frequency = {min(WAVELENGTHS * speed / experiment.distance, longest):.2g}"
            if configuration.excitation.table is not None
            else "a wider packing"
        )
        yield f"hard to read at {content:g} %: {why}; {cure} is better"


def _available_memory() -> float | None:
    """Bytes available without swapping; None if the system does not report them."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(1024.0 * float(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration):
        return None


def _free_space(configuration: Configuration) -> float | None:
    """Free bytes for the database; None on a server."""
    path = Address.parse(configuration.database).path
    if path is None:
        return None
    folder = next(folder for folder in path.absolute().parents if os.path.isdir(folder))  # noqa: PTH112 - names may be too long
    return float(shutil.disk_usage(folder).free)


def _expected_speeds(
    configuration: Configuration, packing: Packing | None, contents: Collection[float]
) -> dict[float, float]:
    """Expected shear-wave velocity at each content, m/s.

    It is the static speed of one sample. Without a packing, or for a large one, it is half of that of the hexagonal
    lattice, increased linearly with the calcite content; with cement this is correct within a factor of two.
    """
    lattice = np.pi * float(np.mean(configuration.packing.diameter)) * cutoff_estimate(configuration, cemented=False)
    rough = {content: 0.5 * float(lattice) * (1.0 + content) for content in contents}
    if packing is None or len(packing.radius) > 20_000:  # whose static stiffness takes a second or two
        return rough
    experiment = configuration.experiment(packing)
    found = {}
    for content in contents:
        try:
            found[content] = expected_speed(experiment, content, patterns=1)
        except ValueError:  # the sample carries no shear
            found[content] = rough[content]
    return found


def _expected_cost(
    configuration: Configuration,
    speeds: Mapping[float, float],
    batches: Sequence[Batch[Cell]],
    checks: Collection[float] = (),
) -> _ExpectedCost:
    """Cost of the batches of a configuration with these speeds of waves, m/s, and of the checks of some contents."""
    wave, lanes, disks = configuration.wave, configuration.run.lanes, disks_in_box(configuration)
    # With the linear law 5 ns for a disk, a step and a sample, eight samples side by side.
    slower_law = 4.4 if wave.law == "finite" else 1.0
    sides = 2 if wave.both_sides else 1

    def seconds_of_lane(content: float) -> float:
        """Of the wave of one sample with the linear law, until its reading is settled."""
        # The stability limit of a cemented sample is 1.18 to 1.20 times that of mean disks, at 0.66 to 9 % of `paper`.
        longer = 1.19 if content > 0.0 else 1.0
        step = wave.step_fraction * longer * limit_of_mean_disks(configuration, cemented=content > 0.0)
        return 1.25 * time_of_wave(configuration, content, speeds[content]) / step * disks * 5e-9

    seconds = sum(60.0 * seconds_of_lane(content) for content in checks)  # 45 to 75 samples (docs/accuracy.md)
    cells = 0
    for batch in batches:
        # Reading, numerical error and graph take 0.02 s.
        seconds += sides * lanes * slower_law * seconds_of_lane(batch.cells[0][1]) + 0.02 * len(batch.cells)
        cells += len(batch.cells)
    slower = _seconds_of_arithmetic() / SECONDS_WHERE_MEASURED
    return _ExpectedCost(
        seconds=slower * seconds,
        packing_seconds=slower * 15.0 * (disks / 4700) ** 1.5,  # 15 s for 4,700 disks
        # Bytes of Python with NumPy and numba, of each disk, and of each disk of each lane.
        memory=210e6 + disks * (1e3 + lanes * 800.0),
        # Bytes of a campaign, of a cell, and of a cell and disk in the database; the NetCDF file has as many.
        disk=2.0 * (150e3 + cells * (18e3 + disks * 2.0)),
    )


def _seconds_of_arithmetic() -> float:
    """CPU time of some NumPy arithmetic on this machine, s; the shortest of several, since other programs may run."""
    values, least = np.linspace(1.0, 2.0, 4096), np.inf
    for _ in range(5):
        began = thread_time()
        for _ in range(300):
            np.sqrt(values * values + values)
        least = min(least, thread_time() - began)
    return float(least)
