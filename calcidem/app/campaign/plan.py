"""Cells that a run computes: batches, parts of a campaign, and seeds until intervals are narrow enough."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from typing import Self

import numpy as np

from calcidem.app.config.schema import CampaignPlan, Configuration
from calcidem.dem.wave.experiment import WAVELENGTHS
from calcidem.storage.records import CellResult, canonical_content
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection
from calcidem.sweep.schedule import Batch, BatchOutcome, Cell, plan_batches


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
    def of_store(cls, store: Store, plan: CampaignPlan) -> Self:
        """Keep the velocities of cells with an outcome, for the contents of a plan."""
        wanted = Selection(contents=plan.contents)
        pending = {(key.seed, key.content) for key in store.pending(contents=plan.contents)}
        columns = store.table(("seed", "content", "vs"), wanted)
        cells = zip(columns["seed"].tolist(), columns["content"].tolist(), strict=True)
        return cls(
            plan, {cell: vs for cell, vs in zip(cells, columns["vs"].tolist(), strict=True) if cell not in pending}
        )
