"""Rebuild a campaign in a store from a file that `calcidem.storage.netcdf.export` wrote."""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

import netCDF4
import numpy as np
from numpy.typing import NDArray

from calcidem.storage.conventions import LAYOUT
from calcidem.storage.errors import (
    DamagedStoreError,
    ForeignDatabaseError,
    NewerSchemaError,
    OlderSchemaError,
    StoreUnavailableError,
)
from calcidem.storage.netcdf.groups import CellArrays, Group, read_attempts, read_packings
from calcidem.storage.netcdf.trial import refuse_unreadable
from calcidem.storage.records import (
    ARRAY_RECORDS,
    NOT_PLANNED,
    QUANTITY_BY_NAME,
    STATUS_CODES,
    CampaignRecord,
    CellKey,
    CellResult,
    CellStatus,
    GraphSummary,
    PackingRecord,
    PathFeatures,
    RunRecord,
    WorkerRecord,
)
from calcidem.storage.records.campaign import refuse_other_packing
from calcidem.storage.records.quantity import quantities_of
from calcidem.storage.sql.store import Store

_SEEDS_IN_MEMORY = 500
_VALUE_NAMES = tuple(
    name for name, q in QUANTITY_BY_NAME.items() if q.formula is None and name not in {"seed", "content", "status"}
)
_OWN_QUANTITIES = tuple(quantity for quantity in quantities_of(CellResult) if quantity.name != "status")
_P = TypeVar("_P", PathFeatures, GraphSummary)
_STATUS_NAMES = {code: name for name, code in STATUS_CODES.items()}
_WITHOUT_OUTCOME = tuple(STATUS_CODES[name] for name in (CellStatus.PENDING, CellStatus.DAMAGED, NOT_PLANNED))
_CURE_OF_CHANGE = "The file was changed after it was exported: export it again. Nothing was written."


def import_netcdf(
    path: str | os.PathLike[str],
    store: Store,
    identify: Callable[[PackingRecord], PackingRecord] = lambda packing: packing,
) -> CampaignRecord:
    """Rebuild the campaign of an exported file: plan, runs, packings, attempts, outcomes and their arrays.

    Importing into a store that has the campaign already adds what is missing and leaves done cells as they
    are; runs are added each time. All of it is one transaction: after any error the store is as it was.

    Parameters
    ----------
    path : str or path
    store : Store
    identify : callable
        Checks the state of a packing and adds the content hash, which is beyond the store.

    Returns
    -------
    CampaignRecord
        As stored.

    Raises
    ------
    StoreUnavailableError
        If the file can't be read as NetCDF.
    ForeignDatabaseError
        If calcidem didn't write it.
    OlderSchemaError, NewerSchemaError
        If an earlier or a later calcidem did, in another layout.
    DamagedStoreError
        If its configuration is not the one that its hash was made of, or cells have a packing that it lacks, or
        reading it does not come to an end.
    CampaignMismatchError
        If the store has a campaign of that name with another hash, or that campaign with another packing.
    LeaseHeldError
        While a run writes the store's database.
    """
    with _open(Path(path)) as file, store.together():
        campaign = CampaignRecord(
            hash=file.calcidem_campaign_hash,
            name=file.calcidem_campaign_name,
            config=file.calcidem_config,
            contents=(),
            seeds=(),
            created=datetime.fromisoformat(file.calcidem_created),
        )
        if campaign.checksum != file.calcidem_checksum:
            raise DamagedStoreError(
                f"{path}: its configuration, or the hash {campaign.hash} of its cells, is not what was exported.",
                _CURE_OF_CHANGE,
            )
        packings = [identify(packing) for packing in read_packings(file)]
        _check_packings_of_cells(path, file, packings)
        name = store.begin_campaign(campaign).name
        _refuse_other_packings(path, store, packings, identify)
        for packing in packings:
            store.save_packing(packing)
        status: NDArray[np.int8] = np.asarray(file["status"][:], dtype=np.int8)
        seeds, contents = file["seed"][:].tolist(), file["content"][:].tolist()
        planned = np.argwhere(status != STATUS_CODES[NOT_PLANNED]).tolist()
        store.plan(CellKey(seeds[i], contents[j]) for i, j in planned)
        run_numbers = {
            run.pop("number"): store.begin_run(_run_from_json(run)) for run in json.loads(file.calcidem_runs)
        }
        store.restore_attempts(read_attempts(file, run_numbers))
        store.record_results(_results(file, status))
        return store.use_campaign(name)


def _open(path: Path) -> Group:
    refuse_unreadable(path)
    try:
        file = netCDF4.Dataset(path, "r")
    except OSError as error:
        raise StoreUnavailableError(f"{path} can't be read as NetCDF ({error}).", "Check the name.") from error
    file.set_auto_mask(False)
    layout, former = getattr(file, "calcidem_layout", None), getattr(file, "calcidem_format", None)
    if layout == LAYOUT:
        return file
    file.close()
    if former is not None:
        raise OlderSchemaError(
            f"{path} was exported by calcidem 0.1.0 or earlier, whose layout this calcidem does not read.",
            "Use that version, or compute the campaign anew.",
        )
    if layout is None:
        raise ForeignDatabaseError(f"{path} was not written by calcidem.", "Give a file made by 'calcidem export'.")
    raise NewerSchemaError(
        f"{path} has layout {layout}; this calcidem reads {LAYOUT}.", "Use the calcidem that wrote it, or a later one."
    )


def _check_packings_of_cells(path: str | os.PathLike[str], file: Group, packings: Sequence[PackingRecord]) -> None:
    with_outcome = ~np.isin(file["status"][:], _WITHOUT_OUTCOME)
    lacking = set(np.asarray(file["packing_index"][:])[with_outcome].tolist()) - {packing.index for packing in packings}
    if lacking:
        raise DamagedStoreError(
            f"{path}: packing {min(lacking)}, on which cells were computed, is missing.", _CURE_OF_CHANGE
        )


def _refuse_other_packings(
    path: str | os.PathLike[str],
    store: Store,
    packings: Sequence[PackingRecord],
    identify: Callable[[PackingRecord], PackingRecord],
) -> None:
    """Refuse packings other than those of the store's campaign; all are compared before any is stored."""
    present = set(store.packing_indices())
    for packing in packings:
        if packing.index in present:
            stored = store.packing(packing.index)
            with suppress(DamagedStoreError):  # its disks and box can still be compared
                stored = identify(stored)
            refuse_other_packing(stored, packing, ("the database", str(path)))


def _run_from_json(values: dict[str, Any]) -> RunRecord:
    for name in ("started", "ended"):
        if values[name] is not None:
            values[name] = datetime.fromisoformat(values[name])
    workers = tuple(WorkerRecord(**worker) for worker in values.pop("workers"))
    return RunRecord(**values, workers=workers)


def _results(file: Group, status: NDArray[np.int8]) -> Iterator[CellResult]:
    """Outcomes of the file, a block of seeds in memory at a time."""
    arrays = {name: CellArrays(file, name) for name in ARRAY_RECORDS}
    seeds, contents = file["seed"][:].tolist(), file["content"][:].tolist()
    for start in range(0, len(seeds), _SEEDS_IN_MEMORY):
        rows = slice(start, start + _SEEDS_IN_MEMORY)
        columns = {
            # A file of an earlier physics version lacks the quantities that were added since.
            name: _python_values(name, file[name][rows])
            for name in _VALUE_NAMES
            if name in file.variables
        }
        for i, j in np.argwhere(~np.isin(status[rows], _WITHOUT_OUTCOME)).tolist():
            key = CellKey(seeds[start + i], contents[j])
            values: dict[str, Any] = dict.fromkeys(_VALUE_NAMES)
            values |= {name: column[i, j] for name, column in columns.items()}
            yield CellResult(
                key,
                CellStatus(_STATUS_NAMES[int(status[start + i, j])]),
                features=_part(PathFeatures, values),
                graph=_part(GraphSummary, values),
                **{name: of_cells.get(key) for name, of_cells in arrays.items()},
                **{quantity.name: values[quantity.name] for quantity in _OWN_QUANTITIES},
            )


def _part(kind: type[_P], values: Mapping[str, Any]) -> _P | None:
    """Quantities that a cell has or lacks as a whole; the first of them is never missing alone."""
    names = [quantity.name for quantity in quantities_of(kind)]
    return None if values[names[0]] is None else kind(**{name: values[name] for name in names})


def _python_values(name: str, values: NDArray[Any]) -> NDArray[np.object_]:
    """Values of a quantity as Python's own int, float or str, None where missing."""
    kind = QUANTITY_BY_NAME[name].kind
    plain = values.astype(object)
    missing = plain == "" if kind == "text" else values < 0 if kind == "whole" else np.isnan(values)
    plain[missing] = "" if name == "reason" else None
    return plain
