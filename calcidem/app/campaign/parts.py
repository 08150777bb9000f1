"""Batches of a campaign's cells: of all, or of one of several parts of about equal effort."""

from collections.abc import Collection, Mapping
from itertools import product

from calcidem.app.config.schema import Configuration
from calcidem.dem.wave.experiment import WAVELENGTHS
from calcidem.sweep.batch import Batch, Cell, plan_batches


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
    own = set()
    for batch in sorted(batches, key=lambda batch: (-batch.cost, batch.identifier)):
        least = effort.index(min(effort))
        effort[least] += batch.cost
        if least == number - 1:
            own.add(batch.identifier)
    return tuple(batch for batch in batches if batch.identifier in own)


def planned_cells(configuration: Configuration) -> set[Cell]:
    """All cells of a campaign's plan, or of its part; those without cement are in one part."""
    found = {cell for batch in planned_batches(configuration) for cell in batch.cells}
    if any(content == 0.0 for _, content in found):
        found |= {(seed, 0.0) for seed in configuration.campaign.seed_numbers}
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
