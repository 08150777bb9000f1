"""Computing stored cells again, to see whether what the database says is still what the program gives."""

import random
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from calcidem.app.campaign.provenance import cpu_model
from calcidem.app.campaign.task import cell_result
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.storage.campaign import StoredCampaign
from calcidem.storage.errors import UnknownCellError
from calcidem.storage.records import CellKey, CellResult, CellStatus

ExperimentOf = Callable[[int], Experiment]
"""Gives what the cells of a packing share, by the packing's index."""

REPEATABLE = (CellStatus.DONE, CellStatus.NO_ARRIVAL, CellStatus.UNSTABLE)
"""Outcomes that physics decides; the others depend on the machine of the day."""

IN_ANY_CASE = 1e-6
"""Relative difference of Vs that is allowed on another kind of CPU where no error estimate is stored."""

COMPARED_TO_THE_BIT = (
    *("vs", "vs_peak", "vs_first_arrival", "vs_cross_correlation", "frequency", "time_step", "stability_limit"),
    *("steps", "content_reached", "p_contacts", "c_contacts", "clusters", "bonded_contacts"),
)


class Agreement(StrEnum):
    """What came out of the comparison; the value is the sentence for the user."""

    IDENTICAL = "the same to the last bit"
    WITHIN_ERROR = "another kind of CPU, the same within the error estimate"
    DIFFERENT = "different"

    @property
    def good(self) -> bool:
        """Whether the database is confirmed."""
        return self is not Agreement.DIFFERENT


@dataclass(frozen=True, slots=True)
class Verification:
    """One cell, computed again.

    Attributes
    ----------
    stored, computed
        Both outcomes.
    same_cpu
        Whether the kind of CPU is the one that the stored outcome was computed on.
    agreement
        What follows.
    differences
        Names of the quantities that are not the same to the last bit.
    """

    stored: CellResult
    computed: CellResult
    same_cpu: bool
    agreement: Agreement
    differences: tuple[str, ...]

    @property
    def relative_difference(self) -> float | None:
        """Of Vs, computed over stored less 1; None where one of them is missing."""
        if self.stored.vs is None or self.computed.vs is None:
            return None
        return self.computed.vs / self.stored.vs - 1.0


def random_cells(campaign: StoredCampaign, count: int, choice: int | None = None) -> tuple[CellKey, ...]:
    """Choose stored cells at random, by seed, then content.

    Parameters
    ----------
    campaign
        An open campaign.
    count
        How many; all where there are fewer.
    choice
        Seed of the choice; None for another one each time.

    Raises
    ------
    UnknownCellError
        If there is none that could be computed again.
    """
    keys = [result.key for result in campaign.select(status=REPEATABLE)]
    if not keys:
        raise UnknownCellError(
            "The campaign has no cell that could be computed again.", "Run it first ('calcidem run')."
        )
    generator = random.Random(choice)
    return tuple(sorted(generator.sample(keys, min(count, len(keys)))))


def verify(
    campaign: StoredCampaign, keys: Iterable[CellKey], experiment_of: ExperimentOf, *, lanes: int = 8
) -> Iterator[Verification]:
    """Compute stored cells again and compare them, as many side by side as there are lanes.

    Parameters
    ----------
    campaign
        An open campaign.
    keys
        Cells with an outcome.
    experiment_of
        Gives what the cells of a packing share, such as `OpenedCampaign.experiment`.
    lanes
        Cells side by side; what a cell gives does not depend on it.

    Raises
    ------
    UnknownCellError
        If a cell has no outcome.
    """
    together: defaultdict[tuple[int, float], list[CellResult]] = defaultdict(list)
    for key in keys:
        stored = campaign.cell(seed=key.seed, content=key.content)
        together[stored.packing_index, key.content].append(stored)
    for (packing_index, content), cells in sorted(together.items(), key=lambda item: item[0]):
        experiment = experiment_of(packing_index)
        for start in range(0, len(cells), lanes):
            yield from verify_batch(campaign, experiment, content, cells[start : start + lanes], lanes)


def verify_batch(
    campaign: StoredCampaign, experiment: Experiment, content: float, cells: Sequence[CellResult], lanes: int
) -> Iterator[Verification]:
    """Compute cells of one content and one packing."""
    found = measure(experiment, content, [cell.key.seed for cell in cells], lanes=lanes)
    for stored, measurement in zip(cells, found, strict=True):
        computed = cell_result(measurement, experiment.packing.pairs, store_signals=stored.signal is not None)
        yield compare_outcomes(stored, computed, same_cpu=cpu_of(campaign, stored) == cpu_model())


def cpu_of(campaign: StoredCampaign, stored: CellResult) -> str | None:
    """Return the kind of CPU that a cell was computed on; None if that is not known.

    It is that of rank 0 of its run: clusters whose nodes differ have to be told apart by their partitions.
    """
    attempts = campaign.history(seed=stored.key.seed, content=stored.key.content)
    number = next((attempt.run_id for attempt in attempts if attempt.number == stored.attempt), None)
    return next((run.cpu for run_id, run in campaign.runs() if run_id == number), None)


def compare_outcomes(stored: CellResult, computed: CellResult, *, same_cpu: bool) -> Verification:
    """Compare two outcomes of one cell: to the last bit on the same kind of CPU, else within the error estimate."""
    differences = tuple(different_quantities(stored, computed))
    agreement = Agreement.IDENTICAL
    if differences:
        tolerated = not same_cpu and within_error(stored, computed)
        agreement = Agreement.WITHIN_ERROR if tolerated else Agreement.DIFFERENT
    return Verification(stored, computed, same_cpu, agreement, differences)


def different_quantities(stored: CellResult, computed: CellResult) -> Iterator[str]:
    """Name what is not the same to the last bit; arrays only where they were stored."""
    if stored.status != computed.status:
        yield "status"
    for name in COMPARED_TO_THE_BIT:
        if getattr(stored, name) != getattr(computed, name):
            yield name
    for name in ("cement", "signal"):
        if getattr(stored, name) is not None and getattr(stored, name) != getattr(computed, name):
            yield name


def within_error(stored: CellResult, computed: CellResult) -> bool:
    """Whether two outcomes say the same: equal status and cement, and a Vs within the stored error estimate."""
    if (
        stored.status != computed.status
        or stored.p_contacts != computed.p_contacts
        or stored.clusters != computed.clusters
    ):
        return False
    if stored.vs is None or computed.vs is None:
        return True
    return bool(np.isclose(computed.vs, stored.vs, rtol=stored.error_estimate or IN_ANY_CASE, atol=0.0))
