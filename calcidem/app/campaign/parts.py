"""Which cells of its plan a run is to compute: all, or one of several parts of about equal effort."""

from itertools import product

from calcidem.app.campaign.task import expected_effort
from calcidem.app.config.schema import Configuration
from calcidem.sweep.batch import Batch, Cell, plan_batches


def planned_batches(configuration: Configuration) -> tuple[Batch[Cell], ...]:
    """All batches of a campaign's plan, or those of the part that ``[run] part`` names.

    The parts depend on the configuration alone. The batches are dealt out, long ones first, to the part with the least
    effort so far (Graham 1969, doi:10.1137/0117039).
    """
    plan = configuration.campaign
    batches = plan_batches(
        product(plan.seed_numbers, plan.contents),
        configuration.run.lanes,
        lambda content: expected_effort(configuration, content),
    )
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
