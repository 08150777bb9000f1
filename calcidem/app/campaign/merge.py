"""Merging of stored campaigns of one configuration: plans, runs, histories and outcomes, unless they conflict."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, TypeAlias

from calcidem.ends import CellStatus
from calcidem.storage.errors import CampaignMismatchError, LeaseHeldError
from calcidem.storage.records import EXACT_QUANTITIES, AttemptRecord, CellKey, PackingRecord, RunRecord, Selection
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.lease import replace_database
from calcidem.storage.sql.reading import chunks
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.wording import first_of

_Values: TypeAlias = tuple[Any, ...] | None
"""`EXACT_QUANTITIES` of a done cell, else None."""

_Numbers: TypeAlias = Mapping[tuple[int, CellKey, int], int]
"""New number of an attempt by its source, its cell and its number there."""


@dataclass(frozen=True, slots=True)
class Merged:
    """Outcome of a merge."""

    sources: tuple[str, ...]
    """Databases that were merged; the first is the target if it existed."""
    settled: int
    """Number of cells with an outcome."""
    missing: tuple[CellKey, ...]
    """Planned cells without an outcome."""
    taken: tuple[int, ...]
    """Outcomes taken from each source."""
    shared: int
    """Number of done cells with the same values in several sources."""
    overruled: int
    """Number of cells that are done in one source and failed in another."""
    conflicts: tuple[str, ...]
    """Done cells with different values, a line for each: the cell, its velocities and the names of the quantities.
    With any and without a preferred source, nothing was written.
    """

    def missing_lines(self) -> list[str]:
        """One line for each content with pending cells, with their seeds as ranges."""
        lines = []
        for content in sorted({key.content for key in self.missing}):
            seeds = [key.seed for key in self.missing if key.content == content]
            begins = [seed for seed, before in zip(seeds, [None, *seeds], strict=False) if before != seed - 1]
            ends = [seed for seed, after in zip(seeds, [*seeds[1:], None], strict=True) if after != seed + 1]
            ranges = [str(a) if a == b else f"{a}-{b}" for a, b in zip(begins, ends, strict=True)]
            lines.append(f"  {content:g} %: {len(seeds)} cells, seeds {', '.join(first_of(ranges))}")
        return lines


def merge_databases(
    sources: Sequence[str], out: Path, prefer: str | None = None, campaign_name: str | None = None
) -> Merged:
    """Merge the campaign of some databases or URLs into a file, which is new or has the same campaign.

    It changes only once all is complete, and no run may be writing it. The sources are only read. What the file has
    stays, but for cells that are done elsewhere, or with other values in a preferred source. ``prefer`` is the
    source whose values count where done cells differ. `FileExistsError` if the file has several campaigns,
    `CampaignMismatchError` if configurations or packings differ, or done cells and no source is preferred,
    `LeaseHeldError` if the file is being written, other `StoreError` if a database cannot be read.
    """
    target = Address.parse(out).path or out
    # The target comes first, since of equal outcomes the first is taken: a source may lack arrays that it has.
    names = sorted(sources, key=lambda name: Address.parse(name).path != target)
    with ExitStack() as stack:
        temporary = stack.enter_context(replace_database(target))
        if target.exists() and target.stat().st_size and target != Address.parse(names[0]).path:
            with Store(target, read_only=True) as former:
                if former.campaigns():  # a run that was killed at its start leaves none
                    names.insert(0, str(out))
        campaigns = [stack.enter_context(read_campaign(name, campaign_name)) for name in names]
        for campaign in campaigns:
            if campaign.address.path != target:
                continue
            if len(campaign.campaigns()) > 1:
                raise FileExistsError(f"{out} has several campaigns; give another file for the merged database.")
            if (holder := campaign.lease_holder()) is not None and holder.may_live():
                raise LeaseHeldError(
                    f"{out} is being written by process {holder.pid} on {holder.host}.", "Wait until it has ended."
                )
        with Store(temporary) as store:
            merged = _merge_campaigns(campaigns, store, names, None if prefer is None else names.index(prefer))
        if merged.conflicts and prefer is None:
            raise CampaignMismatchError(
                "\n  ".join([f"{len(merged.conflicts)} done cells have different values:", *first_of(merged.conflicts)])
                + "\n",
                "Nothing was written. Such values come from a changed file or another version of calcidem; "
                "give --prefer with the database to take.",
            )
    return merged


def _merge_campaigns(sources: Sequence[Store], target: Store, names: Sequence[str], prefer: int | None) -> Merged:
    """Write the union of some campaigns of one configuration into an empty store, see `merge_databases`.

    A done outcome replaces any other; that of the preferred source replaces other done ones. Of equal ones the first is
    taken. Attempts of a cell are sorted by time and numbered again. Runs and attempts that occur in several sources,
    since one is a copy of another, are copied once.
    """
    _refuse_other_campaigns(sources)
    packings = _join_packings(sources)
    choice: dict[CellKey, int] = {}
    conflicts: list[str] = []
    shared = overruled = 0
    for key, found in sorted(_settled_cells(sources).items()):
        done = {source: values for source, values in found.items() if values is not None}
        candidates = done or found
        choice[key] = prefer if prefer is not None and prefer in candidates else min(candidates)
        overruled += 0 < len(done) < len(found)
        quantities = zip(EXACT_QUANTITIES, *done.values(), strict=False)
        if different := tuple(name for name, *values in quantities if len(set(values)) > 1):
            # The first of the quantities is the velocity.
            said = (f"Vs {values[0] or math.nan:.9g} m/s in {names[source]}" for source, values in done.items())
            conflicts.append(f"{key}: {', '.join(said)} (different: {', '.join(different)})")
        else:
            shared += len(done) > 1
    merged = Merged(
        sources=tuple(names),
        settled=len(choice),
        missing=tuple(sorted(set().union(*(source.statuses() for source in sources)) - choice.keys())),
        taken=tuple(list(choice.values()).count(source) for source in range(len(sources))),
        shared=shared,
        overruled=overruled,
        conflicts=tuple(conflicts),
    )
    if conflicts and prefer is None:
        return merged
    target.begin_campaign(replace(sources[0].record, seeds=(), contents=()))
    for packing in packings:
        target.save_packing(packing)
    for source in sources:
        target.plan(source.statuses())
    numbers = _copy_history(sources, target)
    for position, source in enumerate(sources):
        chosen = (
            replace(result, attempt=numbers[position, result.key, result.attempt])
            for result in source.results(with_arrays=True)
            # Without a number it is a later change of the source.
            if choice.get(result.key) == position and (position, result.key, result.attempt) in numbers
        )
        for block in chunks(chosen, 200):
            target.record_results(block)
    return merged


def _refuse_other_campaigns(sources: Sequence[Store]) -> None:
    """Raise `CampaignMismatchError` unless all sources have the same physics version and configuration."""
    first = sources[0].record
    for position, record in enumerate((source.record for source in sources), 1):
        if record.physics_version != first.physics_version:
            raise CampaignMismatchError(
                f"The campaign '{first.name}' has physics version {first.physics_version} in database 1 and "
                f"{record.physics_version} in database {position}: the same cells have other bits in the two.",
                "Cells of two versions can't be in one campaign: compute those of one database again with the "
                "calcidem of the other.",
            )
        first.refuse_other(record)


def _join_packings(sources: Sequence[Store]) -> list[PackingRecord]:
    """All packings of the sources; `CampaignMismatchError` if two of the same number differ, or cells have none."""
    first: dict[int, tuple[PackingRecord, str]] = {}
    for position, source in enumerate(sources, 1):
        place = f"database {position}"
        indices = source.packing_indices()
        used = source.table(("packing_index",), Selection(where="packing_index is not None"))["packing_index"]
        if lacking := set(used.astype(int).tolist()) - set(indices):
            raise CampaignMismatchError(
                f"Packing {min(lacking)}, on which cells were computed, is missing in {place}.",
                "Whether it is the packing of the other cells cannot be checked; leave this database out.",
            )
        for index in indices:
            packing = source.packing(index)
            other, other_place = first.setdefault(index, (packing, place))
            other.refuse_other(packing, (other_place, place))
    return [packing for packing, _ in first.values()]


def _settled_cells(sources: Sequence[Store]) -> dict[CellKey, dict[int, _Values]]:
    """Outcomes of all settled cells, by the position of the source."""
    settled: defaultdict[CellKey, dict[int, _Values]] = defaultdict(dict)
    for position, source in enumerate(sources):
        columns = source.table(("seed", "content", "status", *EXACT_QUANTITIES))
        for seed, content, status, *values in zip(*(column.tolist() for column in columns.values()), strict=True):
            if status != CellStatus.PENDING:
                known = tuple(None if value in {None, ""} or value != value else value for value in values)  # noqa: PLR0124 - NaN
                settled[CellKey(int(seed), content)][position] = known if status == CellStatus.DONE else None
    return settled


def _copy_history(sources: Sequence[Store], target: Store) -> _Numbers:
    """Copy runs and attempts, each once; return the new numbers of the attempts."""
    copies_of_run: defaultdict[tuple[datetime, str], list[RunRecord]] = defaultdict(list)
    for source in sources:
        for _, run in source.runs():
            copies_of_run[run.started, run.host].append(run)
    # A copy that was made during the run does not know its end.
    runs = {
        same: target.begin_run(max(copies_of_run[same], key=lambda run: run.ended is not None))
        for same in sorted(copies_of_run)
    }
    attempts: defaultdict[CellKey, dict[tuple[object, ...], AttemptRecord]] = defaultdict(dict)
    copies: dict[tuple[int, CellKey, int], tuple[object, ...]] = {}
    for position, source in enumerate(sources):
        run_numbers: dict[int | None, int] = {number: runs[run.started, run.host] for number, run in source.runs()}
        for attempt in source.history():
            if attempt.outcome == CellStatus.RUNNING:
                continue  # in a copy nobody will end it, which would count as the death of a run
            moved = replace(attempt, run_id=run_numbers.get(attempt.run_id))
            known = attempts[attempt.key].get(attempt.identity, moved)
            attempts[attempt.key][attempt.identity] = replace(known, forgiven=known.forgiven or moved.forgiven)
            copies[position, attempt.key, attempt.number] = attempt.identity
    numbers: dict[tuple[CellKey, tuple[object, ...]], int] = {}
    for key, found in attempts.items():
        in_time = sorted(found.items(), key=lambda item: (item[1].recorded, item[1].number))
        numbers |= {(key, identity): number for number, (identity, _) in enumerate(in_time, start=1)}
    target.restore_attempts(
        replace(attempt, number=numbers[key, identity])
        for key, found in attempts.items()
        for identity, attempt in found.items()
    )
    return {(position, key, old): numbers[key, identity] for (position, key, old), identity in copies.items()}
