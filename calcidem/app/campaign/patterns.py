"""Conversion of cement and sections between store and simulation; cement that is not stored is drawn again.

Loads no kernel, so that stored cells can be read and drawn without.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from calcidem.app.campaign.identity import physics_version
from calcidem.app.campaign.packing import stored_packing
from calcidem.app.config.schema import PHYSICS_VERSION, Configuration
from calcidem.dem.sample.cement import CementCapacityError, PlacedCement, UnknownPatternError
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.reading import PickRule, Reading, read_section
from calcidem.dem.wave.rule import WaveRule
from calcidem.dem.wave.section import RESOLUTION, Section, clamp_of_strip
from calcidem.ends import Verdict
from calcidem.storage.errors import StoreError
from calcidem.storage.records import CellResult, CementPattern, RecordedSection

if TYPE_CHECKING:
    from calcidem.storage.sql.store import Store  # which the ranks do not need


def stored_experiment(store: "Store", packing_index: int = 0) -> Experiment:
    """Experiment of the cells of a packing, as `calcidem.Campaign.experiment`, for modules that `Campaign` imports."""
    packing = stored_packing(store.packing(packing_index))
    return Configuration.from_physics(store.record.parameters).experiment(packing)


def with_patterns(store: "Store", outcomes: Iterable[CellResult]) -> Iterator[CellResult]:
    """Yield outcomes of a store; cement that is not stored is drawn again from the seed.

    An outcome has no cement if it was never drawn, or would differ now: with another physics version, or without the
    stored packing.
    """
    same_physics = physics_version(store.record) == PHYSICS_VERSION
    experiment = lru_cache(lambda index: stored_experiment(store, index))
    # Cells are sorted by seed; without cement all seeds are the same sample, here that of seed 0.
    ordering = lru_cache(2)(lambda index, seed: experiment(index).ordering(seed))
    for outcome in outcomes:
        if not same_physics or outcome.cement is not None or outcome.bonded_contacts is None:
            yield outcome
            continue
        try:
            seed = outcome.key.seed if outcome.key.content else 0
            cement = ordering(outcome.packing_index, seed).at(outcome.key.content)
        except (StoreError, CementCapacityError, UnknownPatternError):
            yield outcome
            continue
        drawn = cement.content_reached, cement.p_contacts, cement.c_contacts, cement.clusters
        known = outcome.content_reached, outcome.p_contacts, outcome.c_contacts, outcome.clusters
        packing = experiment(outcome.packing_index).packing
        yield replace(outcome, cement=pattern_of(packing, cement)) if drawn == known else outcome


def pattern_of(packing: Packing, cement: PlacedCement) -> CementPattern:
    """Record of the cement for the store."""
    contacts = packing.pairs[cement.bonded].astype(np.int32)
    return CementPattern(contacts, cement.kind[cement.bonded], cement.centres.astype(float))


def stored_section(section: Section) -> RecordedSection:
    """Record of a section for the store."""
    return RecordedSection(
        sampling_interval=section.sampling_interval,
        start_time=section.start_time,
        pulse_frequency=section.frequency,
        resolution=section.amplitude * RESOLUTION,
        places=np.array(section.places),
        across=section.across,
        along=section.along,
    )


def section_of(stored: RecordedSection) -> Section:
    """Section from a record, with the same bits as recorded."""
    return Section(
        sampling_interval=stored.sampling_interval,
        start_time=stored.start_time,
        frequency=stored.pulse_frequency,
        amplitude=stored.resolution / RESOLUTION,
        places=tuple(stored.places.tolist()),
        across=stored.across,
        along=stored.along,
    )


def section_reader(store: "Store") -> Callable[[CellResult], Reading | Verdict]:
    """Return a function that reads the stored section of a cell again, with the configuration of its campaign.

    It raises a `ValueError` without a section, and takes each packing from the store once.
    """
    wave, pick = (store.record.parameters.get(name, {}) for name in ("wave", "pick"))
    rule = PickRule(**{field.name: pick[field.name] for field in fields(PickRule) if field.name in pick})
    layers = 2.0 * wave.get("boundary_thickness", WaveRule().boundary_thickness)
    clamp = lru_cache(lambda index: clamp_of_strip(store.packing(index).height - layers))

    def read(cell: CellResult) -> Reading | Verdict:
        if cell.section is None:
            raise ValueError(f"cell = {cell.key}: no section is stored")
        return read_section(section_of(cell.section), clamp(cell.packing_index), rule)

    return read
