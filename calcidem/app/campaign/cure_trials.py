"""Whether what may give a sample a velocity does, when it is tried; nothing is written to the database."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from calcidem.app.campaign.cures import Cure
from calcidem.app.campaign.diagnosis import Diagnosis
from calcidem.app.campaign.identity import refuse_other_physics
from calcidem.app.campaign.patterns import stored_experiment
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.settling import SettlingError
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure_all
from calcidem.storage.campaign import StoredCampaign
from calcidem.storage.records import CellStatus

_LEAST_MOVED, _SAME_VS = 0.02, 0.1
"""Relative changes: of the neighbours' mean Vs that is too much for a cure, and of a cell's Vs from cure to cure."""

_BATCH = 8
"""Cells that are tried side by side: those without velocity, and readable ones for comparison."""


class Verdict(StrEnum):
    """What came of a cure that was tried, the best first."""

    WORKS = "works"
    HELPS = "helps some"
    UNCHECKED = "no neighbour to compare"
    MOVES = "moves other Vs"
    LOSES = "loses as many"
    FAILED = "failed"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class CureTrial:
    """What a cure gave on cells of one content.

    Attributes
    ----------
    content
        Percent.
    cure
        What was set.
    velocities
        Vs by seed of the cells that had none, m/s; None where they still have none.
    neighbours
        Vs by seed of readable cells before and with the cure, m/s; None where it is not readable any more.
    refusal
        Why it cannot be set, and then nothing was computed; empty otherwise.
    """

    content: float
    cure: Cure
    velocities: Mapping[int, float | None]
    neighbours: Mapping[int, tuple[float, float | None]]
    refusal: str = ""

    @property
    def cured(self) -> int:
        """How many cells have a velocity now."""
        return sum(vs is not None for vs in self.velocities.values())

    @property
    def change(self) -> float:
        """Mean relative change of Vs of the neighbours that are still readable; NaN without any."""
        ratios = [after / before for before, after in self.neighbours.values() if after is not None]
        return float(np.mean(ratios)) - 1.0 if ratios else math.nan

    @property
    def lost(self) -> int:
        """How many neighbours are not readable any more."""
        return sum(after is None for _, after in self.neighbours.values())

    @property
    def verdict(self) -> "Verdict":
        """What came of it."""
        if self.refusal:
            return Verdict.REFUSED
        if self.lost >= self.cured:
            return Verdict.LOSES if self.cured else Verdict.FAILED
        if abs(self.change) > _LEAST_MOVED:
            return Verdict.MOVES
        if math.isnan(self.change):
            return Verdict.UNCHECKED
        return Verdict.WORKS if self.cured == len(self.velocities) and not self.lost else Verdict.HELPS


def rank_trials(trials: Iterable[CureTrial]) -> list[CureTrial]:
    """Trials content by content, those that work best first."""
    order = list(Verdict)

    def badness(trial: CureTrial) -> tuple[float, int, int, float]:
        change = 0.0 if math.isnan(trial.change) else abs(trial.change)
        return trial.content, order.index(trial.verdict), trial.lost - trial.cured, change

    return sorted(trials, key=badness)


def contradicted_cells(trials: Iterable[CureTrial]) -> set[tuple[float, int]]:
    """Content and seed of cells to which cures give velocities that differ by more than a tenth.

    What a cure does to the neighbours is taken off before.
    """
    given: defaultdict[tuple[float, int], list[float]] = defaultdict(list)
    for trial in trials:
        scale = 1.0 if math.isnan(trial.change) else 1.0 + trial.change
        for seed, vs in trial.velocities.items():
            if vs is not None:
                given[trial.content, seed].append(vs / scale)
    return {cell for cell, found in given.items() if max(found) > (1.0 + _SAME_VS) * min(found)}


def try_cures(
    campaign: StoredCampaign,
    diagnoses: Sequence[Diagnosis],
    count: int,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[CureTrial]:
    """Compute cells without a velocity again with each of their cures, beside readable ones of the same content.

    Parameters
    ----------
    campaign
        An open campaign; nothing is written to it.
    diagnoses
        Of its cells, from `diagnose`.
    count
        How many of these cells, spread over the contents. Of the values of a key that the cells of a content ask for,
        the most extreme are tried on all.
    progress
        Told what is being computed.

    Yields
    ------
    CureTrial
        Content by content, for each cure that needs no other packing.

    Raises
    ------
    CampaignMismatchError
        If the campaign was computed with another version of the physics.
    """
    refuse_other_physics(campaign.record)
    experiment = stored_experiment(campaign)
    ordering = lru_cache(experiment.ordering)
    for content, chosen in sorted(_spread_over_contents(diagnoses, count).items()):
        seeds = [diagnosis.key.seed for diagnosis in chosen]
        readable = campaign.select(content=content, status=CellStatus.DONE)
        known = {cell.key.seed: cell.vs for cell in readable if cell.vs is not None and cell.packing_index == 0}
        near = sorted(known, key=lambda seed: min(abs(seed - other) for other in seeds))
        near = near[: max(1, _BATCH - len(seeds))]
        of_content = [diagnosis for diagnosis in diagnoses if diagnosis.key.content == content]
        for cure in _strongest_cures(of_content, experiment):
            progress(f"Trying {cure} at {content:g} %")
            try:
                found = measure_all(cure.apply(experiment), content, [*seeds, *near], lanes=_BATCH, ordering=ordering)
            except (ValueError, SettlingError) as error:
                yield CureTrial(content, cure, {}, {}, str(error))
                continue
            vs = {measured.seed: measured.vs for measured in found}
            after = {seed: (known[seed], vs[seed]) for seed in near}
            yield CureTrial(content, cure, {seed: vs[seed] for seed in seeds}, after)


def _spread_over_contents(diagnoses: Sequence[Diagnosis], count: int) -> dict[float, list[Diagnosis]]:
    """So many cells of the first packing, one of each content in turn."""
    waiting: defaultdict[float, list[Diagnosis]] = defaultdict(list)
    for diagnosis in diagnoses:
        waiting[diagnosis.key.content].append(diagnosis)
    ranked = sorted((place, content) for content, cells in waiting.items() for place in range(len(cells)))
    chosen: defaultdict[float, list[Diagnosis]] = defaultdict(list)
    for place, content in ranked[:count]:
        chosen[content].append(waiting[content][place])
    return dict(chosen)


def _strongest_cures(diagnoses: Sequence[Diagnosis], experiment: Experiment) -> list[Cure]:
    """Cures of cells of one content that can be tried; of several values of a key the highest and the lowest."""
    found: dict[tuple[str, bool], Cure] = {}
    for diagnosis in diagnoses:
        for cure in diagnosis.cures:
            if cure.needs_packing:
                continue
            key = cure.name.split(".")[1]
            present = getattr(experiment.wave, key, getattr(experiment.pick, key, diagnosis.frequency))
            rises = not isinstance(cure.value, str) and cure.value > present
            other = found.setdefault((cure.name, rises), cure)
            if not isinstance(cure.value, str) and not isinstance(other.value, str):
                found[cure.name, rises] = (max if rises else min)(other, cure, key=lambda one: float(one.value))
    return list(found.values())


def frequency_table(
    campaign: StoredCampaign, diagnoses: Sequence[Diagnosis], trials: Sequence[CureTrial] = ()
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Contents (percent) and frequencies (Hz) of a campaign, with the highest that is the first cure of a cell.

    Where cures were tried it is the frequency that was best, if it helps. None where no other frequency is left.
    """
    present = Configuration.from_physics(campaign.config).excitation.table.at
    wanted: defaultdict[float, list[float]] = defaultdict(list)
    tried = {trial.content for trial in trials}
    for diagnosis in diagnoses:
        if diagnosis.key.content in tried or not diagnosis.cures:
            continue
        if diagnosis.cures[0].name == "wave.frequency":
            wanted[diagnosis.key.content].append(float(diagnosis.cures[0].value))
    for trial in rank_trials(trials):
        if trial.cure.name == "wave.frequency" and trial.verdict in {Verdict.WORKS, Verdict.HELPS}:
            wanted[trial.content] = wanted[trial.content] or [float(trial.cure.value)]
    contents = campaign.record.contents
    return (contents, tuple(max(wanted.get(at) or [present(at)]) for at in contents)) if wanted else None
