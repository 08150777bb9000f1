"""Rebuild a campaign in a store from a file that `calcidem.storage.netcdf.export` wrote."""

import json
import math
import os
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from calcidem.input_file import MOST_BYTES
from calcidem.storage.dataset import INDEX_NAMES, LAYOUT
from calcidem.storage.errors import (
    DamagedStoreError,
    ForeignDatabaseError,
    OtherSchemaError,
    StoreUnavailableError,
)
from calcidem.storage.netcdf.export import Group
from calcidem.storage.netcdf.trial import refuse_unreadable
from calcidem.storage.records import (
    ARRAY_RECORDS,
    NOT_PLANNED,
    QUANTITY_BY_NAME,
    STATUS_CODES,
    AttemptRecord,
    CampaignRecord,
    CellKey,
    CellResult,
    CellStatus,
    PackingRecord,
    RunRecord,
)
from calcidem.storage.sql.store import Store

_VALUE_NAMES = tuple(name for name, q in QUANTITY_BY_NAME.items() if q.formula is None and name not in INDEX_NAMES)
_WITHOUT_OUTCOME = tuple(STATUS_CODES[name] for name in (CellStatus.PENDING, NOT_PLANNED))
_CURE_OF_CHANGE = "The file was changed after it was exported: export it again. Nothing was written."


def import_netcdf(
    path: str | os.PathLike[str],
    store: Store,
    check: Callable[[PackingRecord], object] = lambda _: None,
) -> CampaignRecord:
    """Rebuild the campaign of an exported file: plan, runs, packings, attempts, outcomes and their arrays.

    If the store already has the campaign, missing data are added and done cells are kept; runs are added each time.
    Everything is one transaction. ``check`` refuses a packing whose state does not fit.

    `InputFileError` if it is no regular file; `StoreUnavailableError` if it is not NetCDF; `ForeignDatabaseError` if
    calcidem did not write it; `OtherSchemaError` if it has another layout; `DamagedStoreError` if it was changed, lacks
    a packing, or can't be read to its end; `CampaignMismatchError` if the store has another campaign of that name, or
    another packing; `LeaseHeldError` while a run writes the database.
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
        packings = list(_read_packings(file))
        for packing in packings:
            check(packing)
        status: NDArray[np.int8] = _read(file["status"]).astype(np.int8)
        named = _read(file["packing_index"])[~np.isin(status, _WITHOUT_OUTCOME)].tolist()
        if lacking := set(named) - {packing.index for packing in packings}:
            raise DamagedStoreError(
                f"{path}: packing {min(lacking)}, on which cells were computed, is missing.", _CURE_OF_CHANGE
            )
        name = store.begin_campaign(campaign).name
        for packing in packings:
            store.save_packing(packing)
        seeds, contents = file["seed"][:].tolist(), file["content"][:].tolist()
        planned = np.argwhere(status != STATUS_CODES[NOT_PLANNED]).tolist()
        store.plan(CellKey(seeds[i], contents[j]) for i, j in planned)
        run_numbers = {}
        for run in json.loads(file.calcidem_runs):
            number = run.pop("number")
            moments = {name: run[name] and datetime.fromisoformat(run[name]) for name in ("started", "ended")}
            known = {name: value for name, value in (run | moments).items() if name in RunRecord.__slots__}
            run_numbers[number] = store.begin_run(RunRecord(**known))  # earlier files describe the workers, too
        store.restore_attempts(_read_attempts(file, run_numbers))
        store.record_results(_results(file, status))
        return store.use_campaign(name)


def _open(path: Path) -> Group:
    refuse_unreadable(path)
    try:
        file = netCDF4.Dataset(path, "r")
    except OSError as error:
        raise StoreUnavailableError(f"{path} can't be read as NetCDF ({error}).", "Check the name.") from error
    file.set_auto_mask(False)
    layout = getattr(file, "calcidem_layout", None)
    if layout == LAYOUT:
        return file
    is_own = layout is not None or hasattr(file, "calcidem_format")  # the mark before 1.0
    file.close()
    if not is_own:
        raise ForeignDatabaseError(f"{path} was not written by calcidem.", "Give a file made by 'calcidem export'.")
    raise OtherSchemaError(
        f"{path} was exported by another version of calcidem, whose files this one does not read (layout {layout}, not "
        f"{LAYOUT}).",
        "Use that version, or compute the campaign again.",
    )


def _results(file: Group, status: NDArray[np.int8]) -> Iterator[CellResult]:
    """Outcomes of the file, a block of seeds in memory at a time."""
    arrays = {name: _Records(file, name, "cell", kind) for name, kind in ARRAY_RECORDS.items()}
    seeds, contents = file["seed"][:].tolist(), file["content"][:].tolist()
    for start in range(0, len(seeds), 500):  # seeds in memory
        rows = slice(start, start + 500)
        columns = {
            # A file of an earlier version may lack quantities.
            name: QUANTITY_BY_NAME[name].as_values(_read(file[name], rows))
            for name in _VALUE_NAMES
            if name in file.variables
        }
        for i, j in np.argwhere(~np.isin(status[rows], _WITHOUT_OUTCOME)).tolist():
            key = CellKey(seeds[start + i], contents[j])
            values: dict[str, Any] = dict.fromkeys(_VALUE_NAMES)
            values |= {name: column[i, j] for name, column in columns.items()}
            yield CellResult.from_values(key, values | {name: found.of_cell(key) for name, found in arrays.items()})


def _read_attempts(file: Group, run_numbers: dict[int, int]) -> Iterator[AttemptRecord]:
    """Read the group ``attempts``; ``run_numbers`` maps numbers of runs in the file to those in the store."""
    records = _Records(file, "attempts", "attempt", AttemptRecord)
    for row, key in enumerate(records.keys()):
        values = records.values(row)
        values["run_id"] = None if values["run_id"] is None else run_numbers[values["run_id"]]
        recorded = datetime.fromtimestamp(records.columns["recorded"][row] / 1e6, UTC)
        yield AttemptRecord(key, recorded=recorded, forgiven=bool(records.columns["forgiven"][row]), **values)


def _read_packings(file: Group) -> Iterator[PackingRecord]:
    """Read the group ``packings``."""
    records = _Records(file, "packings", "packing", PackingRecord)
    for row, stress in enumerate(records.columns.get("wall_stress", ())):
        values = records.values(row)
        yield PackingRecord(wall_stress=json.loads(stress), **(values | {"state": values["state"].tobytes()}))


class _Records:
    """Random access to the records of a group, whose arrays are read block by block.

    Attributes
    ----------
    columns : dict of str to array
        Columns along the dimension of the records; empty in a file without that group.
    """

    def __init__(self, file: Group, name: str, dimension: str, kind: type[Any]) -> None:
        self._group, self._kind = file.groups.get(name), kind
        self.columns = {} if self._group is None else self._read(dimension, slice(None))
        self._block = range(0)
        self._arrays: dict[str, dict[str, NDArray[Any]]] = {}
        self._ends: dict[str, NDArray[np.int64]] = {}
        self._values: dict[str, NDArray[np.object_]] = {}
        if self.columns:
            elements = {along.elements for along in kind.arrays().values()}
            self._ends = {e: np.concatenate(([0], np.cumsum(self.columns[f"{e}_count"]))) for e in elements}
            columns = ((q, self.columns[q.name.removesuffix("_id")]) for q in kind.quantities())
            self._values = {quantity.name: quantity.as_values(column) for quantity, column in columns}

    @cached_property
    def _row(self) -> dict[CellKey, int]:
        return {key: row for row, key in enumerate(self.keys())}

    def of_cell(self, key: CellKey) -> Any:  # noqa: ANN401 - an object of the group's class
        """Return the record of a cell, None if it has none."""
        row = self._row.get(key)
        return None if row is None else self._kind(**self.values(row))

    def keys(self) -> list[CellKey]:
        """Return the cells of the records."""
        columns = (self.columns[name].tolist() if self.columns else () for name in ("seed", "content"))
        return list(map(CellKey, *columns))

    def values(self, row: int) -> dict[str, Any]:
        """Return quantities and arrays of a record by name."""
        if row not in self._block:  # read together with the following ones, since a file is mostly read in order
            count = len(next(iter(self.columns.values())))
            self._block = range(row, min(row + 500, count))
            blocks = {e: slice(ends[row], ends[self._block.stop]) for e, ends in self._ends.items()}
            self._arrays = {elements: self._read(elements, block) for elements, block in blocks.items()}
        values: dict[str, Any] = {name: column[row] for name, column in self._values.items()}
        for name, along in self._kind.arrays().items():
            first, end = self._ends[along.elements][[row, row + 1]] - self._ends[along.elements][self._block.start]
            values[name] = self._arrays[along.elements][name][first:end]
            if along.columns:
                values[name] = values[name].reshape(-1, self.columns[f"{along.columns}_count"][row])
        return values

    def _read(self, dimension: str, rows: slice) -> dict[str, NDArray[Any]]:
        """Read some rows of all columns along a dimension."""
        variables = self._group.variables.items()
        return {name: _read(variable, rows) for name, variable in variables if variable.dimensions[0] == dimension}


def _read(variable: Any, rows: slice = slice(None)) -> NDArray[Any]:  # noqa: ANN401 - the library has no types
    """Read some rows of a variable; `ValueError` if they take more than `MOST_BYTES`."""
    count, *others = variable.shape
    size = len(range(*rows.indices(count))) * math.prod(others) * getattr(variable.dtype, "itemsize", 8)
    if size > MOST_BYTES:
        raise ValueError(f"{variable.name} would take {size / 1e9:.3g} GB of memory at a time")
    return np.asarray(variable[rows])
