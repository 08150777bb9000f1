"""Tests proposed remedies on cells without a velocity; nothing is written to the database."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from calcidem.app.campaign.diagnosis import Diagnosis
from calcidem.app.campaign.identity import refuse_other_physics
from calcidem.app.campaign.patterns import stored_experiment
from calcidem.app.campaign.remedies import Remedy
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.settling import SettlingError
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure_all
from calcidem.storage.records import CampaignRecord, CellStatus
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection

_MOST_CHANGED = 0.02  # of the neighbours' mean Vs that a remedy may make
_BATCH = 8  # cells that are tried side by side: those without velocity, and readable ones for comparison


class TrialOutcome(StrEnum):
    """Outcome of a remedy, the best first."""

    WORKS = "works"
    HELPS = "helps some"
    UNCHECKED = "no neighbour to compare"
    MOVES = "moves other Vs"
    LOSES = "loses as many"
    FAILED = "failed"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class RemedyTrial:
    """What a remedy gave on cells of one content.

    Attributes
    ----------
    content
        Percent.
    remedy
        What was set.
    velocities
        Vs by seed of the cells that had none, m/s; None where they still have none.
    neighbours
        Vs by seed of readable cells before and after, m/s; None where it is lost.
    refusal
        Why it cannot be set; empty if it was computed.
    """

    content: float
    remedy: Remedy
    velocities: Mapping[int, float | None]
    neighbours: Mapping[int, tuple[float, float | None]]
    refusal: str = ""

    @property
    def read(self) -> int:
        """How many cells have a velocity now."""
        return sum(vs is not None for vs in self.velocities.values())

    @property
    def lost(self) -> int:
        """How many neighbours have none any more."""
        return sum(after is None for _, after in self.neighbours.values())

    @property
    def change(self) -> float:
        """Mean relative change of Vs of the neighbours that are still readable; NaN without any."""
        ratios = [after / before for before, after in self.neighbours.values() if after is not None]
        return float(np.mean(ratios)) - 1.0 if ratios else math.nan

    @property
    def outcome(self) -> TrialOutcome:
        """Whether it helped."""
        if self.refusal:
            return TrialOutcome.REFUSED
        if self.lost >= self.read:
            return TrialOutcome.LOSES if self.read else TrialOutcome.FAILED
        if abs(self.change) > _MOST_CHANGED:
            return TrialOutcome.MOVES
        if math.isnan(self.change):
            return TrialOutcome.UNCHECKED
        return TrialOutcome.WORKS if self.read == len(self.velocities) and not self.lost else TrialOutcome.HELPS


def rank_trials(trials: Iterable[RemedyTrial]) -> list[RemedyTrial]:
    """Trials content by content, those that work best first."""
    order = list(TrialOutcome)

    def badness(trial: RemedyTrial) -> tuple[float, int, int, float]:
        change = 0.0 if math.isnan(trial.change) else abs(trial.change)
        return trial.content, order.index(trial.outcome), trial.lost - trial.read, change

    return sorted(trials, key=badness)


def try_remedies(
    store: Store,
    diagnoses: Sequence[Diagnosis],
    count: int,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[RemedyTrial]:
    """Compute cells without a velocity again with each of their remedies, beside readable ones of the same content.

    Nothing is written to the store. So many of the diagnosed cells, spread over the contents, are tried; of several
    values of a key the most extreme. ``progress`` is told what is being computed. Given are trials content by content,
    for each remedy that needs no other packing. `CampaignMismatchError` if the campaign was computed with another
    version of the physics.
    """
    refuse_other_physics(store.record)
    experiment = stored_experiment(store)
    ordering = lru_cache(experiment.ordering)
    for content, seeds in sorted(_spread_over_contents(diagnoses, count).items()):
        readable = store.results(Selection(contents=content, statuses=CellStatus.DONE))
        known = {cell.key.seed: cell.vs for cell in readable if cell.vs is not None and cell.packing_index == 0}
        near = sorted(known, key=lambda seed: min(abs(seed - other) for other in seeds))
        near = near[: max(1, _BATCH - len(seeds))]
        for remedy in _strongest(diagnosis for diagnosis in diagnoses if diagnosis.key.content == content):
            progress(f"Trying {remedy} at {content:g} %")
            try:
                changed: Experiment = remedy.apply(experiment)
                found = measure_all(changed, content, [*seeds, *near], lanes=_BATCH, ordering=ordering)
            except (ValueError, SettlingError) as error:
                yield RemedyTrial(content, remedy, {}, {}, str(error))
                continue
            vs = {measured.seed: measured.vs for measured in found}
            after = {seed: (known[seed], vs[seed]) for seed in near}
            yield RemedyTrial(content, remedy, {seed: vs[seed] for seed in seeds}, after)


def _spread_over_contents(diagnoses: Sequence[Diagnosis], count: int) -> dict[float, list[int]]:
    """Seeds of this number of cells of each content in turn."""
    waiting: defaultdict[float, list[int]] = defaultdict(list)
    for diagnosis in diagnoses:
        waiting[diagnosis.key.content].append(diagnosis.key.seed)
    ranked = sorted((place, content) for content, seeds in waiting.items() for place in range(len(seeds)))
    chosen: defaultdict[float, list[int]] = defaultdict(list)
    for place, content in ranked[:count]:
        chosen[content].append(waiting[content][place])
    return dict(chosen)


def _strongest(diagnoses: Iterable[Diagnosis]) -> list[Remedy]:
    """Remedies that can be tried; of several values of a key on the same side of the present one the furthest."""
    found: dict[tuple[str, bool], Remedy] = {}
    for diagnosis in diagnoses:
        frequency = diagnosis.case.section.frequency
        for remedy in diagnosis.remedies:
            if remedy.needs_packing:
                continue
            value = remedy.value
            # Of all keys the frequency alone is proposed above and below the present value.
            rises = not isinstance(value, str) and (value > frequency or remedy.name == "pick.largest_error")
            other = found.setdefault((remedy.name, rises), remedy)
            if not isinstance(value, str) and not isinstance(other.value, str):
                found[remedy.name, rises] = (max if rises else min)(other, remedy, key=lambda one: float(one.value))
    return list(found.values())


def frequency_table(
    record: CampaignRecord, diagnoses: Sequence[Diagnosis], trials: Sequence[RemedyTrial] = ()
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Contents (percent) and frequencies (Hz) of a campaign, with the highest that is the first remedy of a cell.

    Where remedies were tried it is the frequency that was best, if it helps. None where no other frequency is left, or
    the campaign chooses its own.
    """
    table = Configuration.from_physics(record.parameters).excitation.table
    if table is None:
        return None
    wanted: defaultdict[float, list[float]] = defaultdict(list)
    tried = {trial.content for trial in trials}
    for diagnosis in diagnoses:
        if diagnosis.key.content not in tried and diagnosis.remedies[0].name == "wave.frequency":
            wanted[diagnosis.key.content].append(float(diagnosis.remedies[0].value))
    useful = {TrialOutcome.WORKS, TrialOutcome.HELPS, TrialOutcome.UNCHECKED}
    for trial in rank_trials(trials):
        if trial.remedy.name == "wave.frequency" and trial.outcome in useful:
            wanted[trial.content] = wanted[trial.content] or [float(trial.remedy.value)]
    contents = record.contents
    return (contents, tuple(max(wanted.get(at) or [table.at(at)]) for at in contents)) if wanted else None
