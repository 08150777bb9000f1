"""Cells: which ones a run computes, and their computation by a worker, as records.

A run computes batches, parts of a campaign, and seeds until intervals are narrow enough.
"""

import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from calcidem.analysis.packing_graph import PackingGraph, packing_graph
from calcidem.analysis.velocity import median_diameter_by_mass, wavelengths
from calcidem.app.campaign.packing import check_path, packing_record, pattern_of, stored_section
from calcidem.app.config.schema import PHYSICS_VERSION, CampaignPlan, Configuration
from calcidem.dem.kernels.compiling import watch_compiling
from calcidem.dem.kernels.gpu import gpu_card
from calcidem.dem.kernels.layout import Flags
from calcidem.dem.sample.cement import GIVEN, CementOrdering, Pattern, content_of_contacts
from calcidem.dem.sample.compaction import SettlingError
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.check import Check, check_content, kernels_of
from calcidem.dem.wave.experiment import WAVELENGTHS, Experiment
from calcidem.dem.wave.measurement import Measurement, measure
from calcidem.dem.wave.propagation import SAMPLES_PER_CHUNK, prepare_recorder
from calcidem.dem.wave.static_speed import LARGEST_STATIC_ERROR, static_speed
from calcidem.storage.errors import OutputRefusedError
from calcidem.storage.files import write_atomically
from calcidem.storage.records import (
    CellKey,
    CellResult,
    CementPattern,
    GrainPath,
    NetworkFeatures,
    PathFeatures,
    Selection,
    canonical_content,
)
from calcidem.sweep.ranks import keep_freed_memory, own_rank
from calcidem.sweep.schedule import Batch, BatchOutcome, Cell, LaunchError, plan_batches
from calcidem.version import __version__

if sys.platform != "win32":
    import fcntl

if TYPE_CHECKING:
    from calcidem.storage.sql.store import Store  # which the ranks do not need


def planned_batches(configuration: Configuration) -> tuple[Batch[Cell], ...]:
    """All batches of a campaign's plan, or those of the part in ``[run] part``.

    The parts depend only on the configuration. The batches, long ones first, are assigned to the part with the least
    effort so far (Graham 1969, doi:10.1137/0117039).
    """
    plan = configuration.campaign
    batches = batches_of(configuration, [*product(plan.seed_numbers, plan.contents)])
    if configuration.run.part is None:
        return batches
    number, parts = configuration.run.part_numbers
    effort = [0.0] * parts
    own = []
    for place, batch in sorted(enumerate(batches), key=lambda item: -item[1].cost):
        least = effort.index(min(effort))
        effort[least] += batch.cost
        if least == number - 1:
            own.append(place)
    return tuple(batches[place] for place in sorted(own))


def planned_cells(configuration: Configuration) -> set[Cell]:
    """All cells of a campaign's plan, or of its part; those without cement are in one part."""
    seeds = configuration.campaign.seed_numbers
    if configuration.run.part is None:
        return set(product(seeds, configuration.campaign.contents))
    found = {cell for batch in planned_batches(configuration) for cell in batch.cells}
    if any(content == 0.0 for _, content in found):
        found |= {(seed, 0.0) for seed in seeds}
    return found


def batches_of(
    configuration: Configuration, cells: Collection[Cell], losses: Mapping[Cell, int] | None = None
) -> tuple[Batch[Cell], ...]:
    """Batches of cells of a campaign, some of which may have lost workers.

    Without cement all seeds give the same sample: it is computed for the first of them alone, and the sink stores the
    outcome for the others.
    """
    first = min((cell for cell in cells if cell[1] == 0.0), default=None)
    distinct = [cell for cell in cells if cell[1] > 0.0 or cell == first]

    def rough_effort(content: float) -> float:
        # In steps; only ratios matter, and measured times replace them. Cement shortens the stable step by a factor of
        # about ten. The velocity increases from 200 m/s to 2100 m/s at 9 %.
        return (10.0 if content > 0.0 else 1.0) * time_of_wave(configuration, content, 200.0 + 210.0 * content)

    return plan_batches(distinct, configuration.run.lanes, rough_effort, losses)


def time_of_wave(configuration: Configuration, content: float, velocity: float) -> float:
    """Time for which a wave with a velocity, m/s, is followed, s: its pulse and one and a half travel times."""
    table, travel = configuration.excitation.table, configuration.packing.width / velocity
    return (travel / WAVELENGTHS if table is None else 1.0 / table.at(content)) + 1.5 * travel


class SeedDemand:
    """Seeds that each content needs so far.

    A content with n seeds gets more, or is finished, only once all seeds 1 to n have an outcome. The number of its
    seeds depends only on their velocities. So it ends with the same seeds on any number of ranks and after any
    interruption. Known velocities are those of cells with an outcome, m/s; NaN without a velocity.
    """

    def __init__(self, plan: CampaignPlan, known: Mapping[Cell, float]) -> None:
        self._plan, self._known = plan, dict[Cell, float]()
        self._learn(known)
        self._counts = {canonical_content(content): len(plan.seed_numbers) for content in plan.contents}
        for content in self._counts:
            self._advance(content)

    @property
    def cells(self) -> list[Cell]:
        """All cells needed so far."""
        return [(seed, content) for content, count in self._counts.items() for seed in range(1, count + 1)]

    def take_in(self, outcomes: Sequence[BatchOutcome[Cell, CellResult]]) -> list[Cell]:
        """Add outcomes; return unknown cells that are needed only now."""
        known: dict[Cell, float] = {}
        for outcome in outcomes:
            for place, cell in enumerate(outcome.batch.cells):
                vs = None if outcome.results is None else outcome.results[place].vs
                known[cell] = np.nan if vs is None else vs
        self._learn(known)
        found: list[Cell] = []
        for content in sorted({content for _, content in known} & self._counts.keys()):
            before = self._counts[content]
            self._advance(content)
            seeds = range(before + 1, self._counts[content] + 1)
            found += [(seed, content) for seed in seeds if (seed, content) not in self._known]
        return found

    def lines(self) -> Iterator[str]:
        """Summary once all cells are known, in sentences."""
        from calcidem.analysis.intervals import FEWEST_READ  # noqa: PLC0415 - statistics, only for `until`

        counts = sorted(self._counts.values())
        cells, equal = sum(counts), counts[-1] * len(counts)
        saving = f", {1 - cells / equal:.0%} less than {equal} with as many at each" if equal > cells else ""
        yield f"Seeds: {counts[0]} to {counts[-1]} a content, {cells} cells{saving}."
        for content, count in sorted(self._counts.items()):
            read = sum(np.isfinite(self._known[seed, content]) for seed in range(1, count + 1))
            if read < FEWEST_READ * count:
                yield f"{content:g} %: no more seeds, since only {read} of {count} have a velocity."
            elif self._next(content, 2 * self._plan.most_seeds):
                yield f"{content:g} %: intervals are wider than campaign.until; campaign.most_seeds is {count}."

    def _learn(self, known: Mapping[Cell, float]) -> None:
        self._known |= known
        for cell, vs in known.items():
            if cell[1] == 0.0:  # without cement all seeds are the same sample
                self._known |= {(seed, 0.0): vs for seed in self._plan.seed_numbers}

    def _advance(self, content: float) -> None:
        while count := self._next(content, self._plan.most_seeds):
            self._counts[content] = count

    def _next(self, content: float, most: int) -> int:
        """Next number of seeds; 0 while an outcome is missing, or if there are enough."""
        from calcidem.analysis.intervals import next_seed_count  # noqa: PLC0415 - as above

        until, count = self._plan.until, self._counts[content]
        cells = [(seed, content) for seed in range(1, count + 1)]
        if until is None or content == 0.0 or not all(cell in self._known for cell in cells):
            return 0
        found = next_seed_count([self._known[cell] for cell in cells], most, mean=until.mean, sd=until.sd)
        return found if found > count else 0

    @classmethod
    def of_store(cls, store: "Store", plan: CampaignPlan) -> Self:
        """Keep the velocities of cells with an outcome, for the contents of a plan."""
        wanted = Selection(contents=plan.contents)
        pending = {(key.seed, key.content) for key in store.pending(contents=plan.contents)}
        columns = store.table(("seed", "content", "vs"), wanted)
        cells = zip(columns["seed"].tolist(), columns["content"].tolist(), strict=True)
        return cls(
            plan, {cell: vs for cell, vs in zip(cells, columns["vs"].tolist(), strict=True) if cell not in pending}
        )


_VERSION = f"calcidem {__version__} with physics version {PHYSICS_VERSION}"
"""Versions that determine the bits of a cell."""


@dataclass(frozen=True)
class CellComputation:
    """Computation of a batch up to the stored bytes, a `calcidem.sweep.schedule.Compute`.

    It is prepared at its first batch, or when it is unpickled. Then the kernels are compiled first, each by one of the
    processes that begin together on a machine.
    """

    configuration: Configuration
    packing: Packing
    """Configuration and packing of the campaign."""

    def __call__(self, batch: Batch[Cell], raise_if_stopped: Callable[[], None], /) -> Sequence[CellResult]:
        """Measure the cells of a batch, which have the same content."""
        run, experiment = self.configuration.run, self._experiment
        content = batch.cells[0][1]
        seeds = [seed for seed, _ in batch.cells]
        measurements = measure(
            experiment,
            content,
            seeds,
            lanes=run.lanes,
            raise_if_stopped=raise_if_stopped,
            ordering=self._ordering,
            checked=partial(self._checked, raise_if_stopped=raise_if_stopped),
        )
        results = [
            cell_result(measurement, experiment, run.store_sections, self._graph) for measurement in measurements
        ]
        if run.static_speed:
            results = [
                replace(result, static_speed=_known_static_speed(experiment, measurement.cement.bonded))
                for result, measurement in zip(results, measurements, strict=True)
            ]
        return tuple(result.pack() for result in results)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle for preparation in another process, without the URL of the database, which may have a password."""
        told = replace(self.configuration, run=replace(self.configuration.run, database=None))
        return _prepared_computation, (told, self.packing, _VERSION, {**GIVEN})

    @cached_property
    def _experiment(self) -> Experiment:
        return self.configuration.experiment(self.packing)

    @cached_property
    def _ordering(self) -> Callable[[int], CementOrdering]:
        # Batches of the same seeds follow each other; a seed has 0.3 MB.
        return lru_cache(64)(self._experiment.ordering)

    def _checked(self, content: float, raise_if_stopped: Callable[[], None]) -> Check:
        """Check of a content, kept in a file for the other processes of the machine and for later runs."""
        path = check_path(self.configuration, self._experiment.packing, content)
        with contextlib.suppress(OSError, ValueError, TypeError):  # without a readable file it is computed
            return Check(**json.loads(path.read_text(encoding="utf-8")))
        found = self._experiment.once(
            check_content, content, self.configuration.run.lanes, raise_if_stopped=raise_if_stopped
        )
        with contextlib.suppress(OSError, OutputRefusedError):  # which only costs time later
            path.parent.mkdir(parents=True, exist_ok=True)
            with write_atomically(path) as temporary:
                temporary.write_text(json.dumps(asdict(found)), encoding="utf-8")
        return found

    @cached_property
    def _graph(self) -> PackingGraph:
        return packing_graph(
            packing_record(self.packing, index=0, packing_hash=self.configuration.packing_hash),
            self.configuration.wave.transmitter_half_width,
            self.configuration.wave.receiver_half_width,
            self.configuration.wave.boundary_thickness,
        )


def _known_static_speed(experiment: Experiment, bonded: Flags) -> float | None:
    """Static speed of a sample, m/s; None if it has none, or its error is too large."""
    try:
        found = static_speed(experiment, bonded)
    except (ValueError, SettlingError):
        return None
    return found.speed if found.error <= LARGEST_STATIC_ERROR else None


def _prepared_computation(
    configuration: Configuration, packing: Packing, version: str, patterns: Mapping[str, Pattern]
) -> CellComputation:
    """Computation in a process of an executor, with compiled kernels."""
    GIVEN.update(patterns)
    if version != _VERSION:
        raise LaunchError(f"a worker has {_VERSION}, the program that stores the campaign has {version}")
    keep_freed_memory()
    gpu = gpu_card().choose((own_rank() or 1) - 1) if configuration.run.gpu else 0  # rank 0 computes nothing
    compilations = kernel_compilations(configuration, packing)
    if sys.platform == "win32":  # each process for itself
        for compile_kernel in compilations:
            compile_kernel()
        return CellComputation(configuration, packing)
    with contextlib.ExitStack() as stack:
        others = []
        for number, compile_kernel in enumerate(compilations):
            path = Path(tempfile.gettempdir()) / f"calcidem-kernel-{gpu}-{number}-{os.getuid()}.lock"
            file = stack.enter_context(path.open("w", encoding="ascii"))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                others.append(file)  # another process compiles it, and proves it on this GPU; continue with the next
                continue
            except OSError:
                pass  # a file system without locks: each process for itself
            compile_kernel()
            file.close()  # and unlock it
        for file in others:
            fcntl.flock(file, fcntl.LOCK_SH)  # wait for it, and load the result from disk
    return CellComputation(configuration, packing)


def cell_result(
    measurement: Measurement, experiment: Experiment, store_sections: bool, graph: PackingGraph | None = None
) -> CellResult:
    """Record of a measurement for the store; the storing process sets attempt, rank and host.

    Without a ``graph`` of the packing, as in `verify`, features of path and network are left out. So no quantity
    that `is_exact` may need it.
    """
    cement, section, reading = measurement.cement, measurement.section, measurement.reading
    packing, pattern = experiment.packing, pattern_of(experiment.packing, cement)
    path, features, network = (None, None, None) if graph is None else _describe_graph(graph, pattern)
    diameter = median_diameter_by_mass(packing.radius)
    on_path, over_d50 = wavelengths(measurement.vs, section.frequency, section.distance, diameter)
    return CellResult(
        key=CellKey(measurement.seed, measurement.content),
        status=measurement.status,
        reason=measurement.reason,
        vs=measurement.vs,
        vs_peak=reading and reading.peak,
        vs_first_arrival=reading and reading.first_arrival,
        vs_cross_correlation=reading and reading.cross_correlation,
        coherence=reading and reading.wave.coherence,
        reading_error=reading and reading.error,
        vs_bias=reading and reading.bias,
        effective_vs=measurement.effective_vs,
        effective_error=measurement.effective_error,
        effective_vs_other_side=measurement.other_wave and measurement.other_wave.velocity,
        frequency=section.frequency,
        distance=section.distance,
        wavelengths_on_path=on_path,
        wavelength_over_d50=over_d50,
        time_step=section.time_step,
        stability_limit=section.stability_limit,
        steps=section.steps,
        law=measurement.check.law,
        numerical_error=measurement.check.numerical_error,
        pulse_effect=measurement.check.pulse_effect,
        side_error=measurement.check.side_error,
        content_reached=cement.content_reached,
        content_of_contacts=content_of_contacts(packing, experiment.cement_rule, cement.kind),
        p_contacts=cement.p_contacts,
        c_contacts=cement.c_contacts,
        clusters=cement.clusters,
        bonded_contacts=int(np.count_nonzero(cement.bonded)),
        broken_bonds=section.broken_bonds,
        retry=section.retry,
        seconds=measurement.seconds,
        features=features,
        network=network,
        path=path,
        section=stored_section(section) if store_sections else None,
        cement=pattern,
    )


def _describe_graph(
    packing: PackingGraph, cement: CementPattern
) -> tuple[GrainPath | None, PathFeatures | None, NetworkFeatures]:
    """Path, its features and those of the network of one sample.

    There is no path if no chain of contacts joins transmitter and receiver.
    """
    bonded = packing.kinds(cement) > 0
    network = packing.network_features(bonded)
    if network.network_gap_contacts is None:
        return None, None, network
    paths = packing.shortest_paths(bonded)
    return GrainPath(np.array(paths.first().grains, dtype=np.int32)), packing.features(paths), network


def kernel_compilations(
    configuration: Configuration, packing: Packing, tell: Callable[[str, str, int], object] = lambda *_: None
) -> list[Callable[[], None]]:
    """Functions that compile the kernels of the campaign, in any order, by a step of one sample.

    ``tell`` receives each compiled function: its kernel, its name, and the number of finished ones.
    """
    experiment = configuration.experiment(packing)
    # Samples settle at once, so that the kernel of their settling is also compiled.
    experiment = experiment.with_wave(unbalanced_force_ratio=1e300)
    seed, content = configuration.campaign.seed_numbers[0], max(configuration.campaign.contents)
    kernels = kernels_of(experiment, configuration.run.lanes)

    def compile_kernel(number: int, name: str, settings: Experiment, lanes: int) -> None:
        bonded = settings.ordering(seed).at(content).bonded
        with watch_compiling(partial(tell, f"{name} ({number} of {len(kernels)})")):
            recorder = prepare_recorder(settings, [bonded], settings.frequency(content), lanes, lambda: None)
            # With a GPU the processor computes the same steps, so there are more of them.
            recorder.record_chunk(SAMPLES_PER_CHUNK if settings.gpu else 1)

    return [partial(compile_kernel, number, *kernel) for number, kernel in enumerate(kernels, 1)]
