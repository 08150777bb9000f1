"""Data of one campaign for the live page, updated from its database by short queries."""

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from threading import RLock
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError
from calcidem.analysis.packing_graph import PackingGraph
from calcidem.app.campaign.packing import with_patterns
from calcidem.app.campaign.status import STATUS_QUANTITIES, CampaignStatus
from calcidem.app.report.cell_data import (
    MOST_FULL_RECORDS,
    SHORT_RECORD,
    describe_axes,
    describe_cells,
    describe_sections,
    numbers_or_none,
    packing_block,
)
from calcidem.app.report.tables import count_reasons
from calcidem.dem.engine.scene import Sand
from calcidem.ends import CellStatus
from calcidem.storage.errors import StoreError, StoreUnavailableError, UnknownCampaignError, hide_passwords
from calcidem.storage.records import QUANTITY_BY_NAME, Selection, StoreMark
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.wording import EXCEPTIONAL


@dataclass(frozen=True, slots=True, eq=False)
class CellColumns:
    """Quantities of all cells of a campaign; the index of a cell is seed index x number of contents + content index."""

    seeds: NDArray[np.int64]
    contents: NDArray[np.float64]
    """Seeds (S,) and contents (C,), percent, ascending."""
    planned: NDArray[np.bool_]
    """Flags of planned cells, (S * C,)."""
    values: dict[str, NDArray[Any]]
    """Quantities by name, (S * C,): float64 with NaN if missing, or texts, "" if missing. The status of a cell without
    an outcome is "".
    """

    @classmethod
    def empty(cls, rows: Mapping[str, NDArray[Any]], names: Sequence[str]) -> Self:
        """Return columns of these names, without values, for the cells with seed and content in rows."""
        seeds, contents = np.unique(rows["seed"].astype(np.int64)), np.unique(rows["content"])
        size = seeds.size * contents.size
        values: dict[str, NDArray[Any]] = {
            name: np.full(size, "", dtype=object) if _holds_texts(name) else np.full(size, np.nan) for name in names
        }
        columns = cls(seeds, contents, np.zeros(size, dtype=bool), values)
        columns.planned[columns.places(rows)] = True
        return columns

    def places(self, rows: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
        """Return the index of each row."""
        seed = np.searchsorted(self.seeds, rows["seed"].astype(np.int64))
        return np.asarray(seed * self.contents.size + np.searchsorted(self.contents, rows["content"]), dtype=np.int64)

    def put(self, rows: Mapping[str, NDArray[Any]]) -> list[int]:
        """Copy known columns of rows, and return the indices of changed cells."""
        places = self.places(rows)
        changed = np.zeros(places.size, dtype=bool)
        for name in self.values.keys() & rows.keys():
            old = self.values[name][places]
            if _holds_texts(name):
                found = np.array([text or "" for text in rows[name].tolist()], dtype=object)
                if name == "status":
                    found[found == CellStatus.PENDING.value] = ""
                same = old == found
            else:
                found = rows[name].astype(np.float64)
                same = (old == found) | (np.isnan(old) & np.isnan(found))
            changed |= ~same
            self.values[name][places] = found
        return [int(place) for place in places[changed]]

    def rows(self, names: Sequence[str]) -> dict[str, NDArray[Any]]:
        """Return columns of the planned cells, as `calcidem.storage.sql.store.Store.table`."""
        seed, content = np.divmod(np.flatnonzero(self.planned), self.contents.size)
        known = {"seed": self.seeds[seed], "content": self.contents[content]}
        found = {name: known[name] if name in known else self.values[name][self.planned] for name in names}
        if "status" in found:
            found["status"][found["status"] == ""] = CellStatus.PENDING.value
        return found

    def settled(self) -> int:
        """Count the cells with an outcome."""
        return int(np.count_nonzero(self.values["status"] != ""))

    def shown(self) -> list[str]:
        """Quantities with a displayed value in some cell; all as long as no cell has an outcome."""
        if not self.settled():
            return list(self.values)
        known = {name: c[c != "" if _holds_texts(name) else np.isfinite(c)] for name, c in self.values.items()}
        return [name for name, column in known.items() if column.size and (name not in EXCEPTIONAL or np.any(column))]

    def packed(self, sequence: int, names: Sequence[str]) -> bytes:
        """Return all cells as bytes: the length of a header, the header as JSON, and the columns that it describes.

        A number has four bytes if these suffice for display, else eight. A text is an index into the few different
        texts. So 100,000 cells are a few megabytes, which a browser need not parse.
        """
        arrays, described, offset = [], [], 0
        for name in names:
            column, texts = self.values[name], dict[str, int]()
            if _holds_texts(name):
                texts = {text: place for place, text in enumerate(dict.fromkeys(column.tolist()))}
                kind, array = "Uint32", np.array([texts[text] for text in column.tolist()], dtype="<u4")
            elif QUANTITY_BY_NAME[name].kind == "whole":
                kind, array = "Float64", column.astype("<f8")
            else:
                kind, array = "Float32", column.astype("<f4")
            data = array.tobytes()
            data += bytes(-len(data) % 8)  # typed arrays of browsers begin at multiples of their element size
            described.append({"name": name, "type": kind, "offset": offset, "texts": list(texts)})
            arrays.append(data)
            offset += len(data)
        axes = describe_axes(self.seeds, self.contents, [name for name in names if name in QUANTITY_BY_NAME])
        header = json.dumps({"sequence": sequence, "columns": described} | axes, allow_nan=False).encode()
        header += b" " * (-(len(header) + 4) % 8)
        return b"".join([len(header).to_bytes(4, "little"), header, *arrays])


def _holds_texts(name: str) -> bool:
    return QUANTITY_BY_NAME[name].kind == "text"


Event = tuple[str, dict[str, Any]]
"""Name and content of a message to browsers."""


class CampaignFeed:
    """Campaign for the page. Any thread may call the methods; one at a time reads the database.

    Attributes
    ----------
    database, name
        Database, and name of the campaign if there are several.
    label
        Database without password, for display.
    sequence
        Number of changes of its cells here.
    """

    def __init__(self, number: int, database: str, name: str | None, *, wait: bool = False) -> None:
        self._wait = wait
        self.number, self.database, self.name = number, database, name
        self.label = hide_passwords(str(Address.parse(database)))
        self.sequence = 0
        self._lock = RLock()
        self._problem = "not read yet"
        self._store: Store | None = None
        self._file: os.stat_result | None = None
        self._analysis: CampaignAnalysis | None = None
        self._columns: CellColumns | None = None
        self._shown: list[str] = []
        self._mark: StoreMark | None = None
        self._read: datetime | None = None
        self._told: dict[str, Any] | None = None
        self._run: tuple[bool, int, str | None] | None = None
        self._unchecked: list[tuple[int, ...]] = []
        self._checked = 0.0

    def refuse_unreadable(self) -> None:
        """Open the database; `StoreError` if it can't be read, or has no such campaign."""
        with self._lock:
            self._open()

    def close(self) -> None:
        """Close the database."""
        with self._lock:
            if self._store is not None:
                self._store.close()
            self._store = self._analysis = self._mark = None

    @property
    def busy(self) -> bool:
        """Whether some cells were not yet read with all quantities."""
        return bool(self._unchecked)

    def refresh(self) -> list[Event]:
        """Read the changes, and return messages for browsers."""
        with self._lock:
            try:
                return self._refresh()
            except StoreError as error:
                self.close()
                problem = hide_passwords(str(error))
                if self._wait and isinstance(error, StoreUnavailableError | UnknownCampaignError):
                    problem = f"Waiting for the campaign to begin: {error.problem}"
                if self._read is not None:
                    problem += f" Shown is what was read at {self._read:%Y-%m-%d %H:%M:%S} UTC."
                told = problem != self._problem
                self._problem = problem
                return [self._status_event()] if told else []

    def status(self) -> dict[str, Any]:
        """Return the progress at the last update, in JSON types; requests do not wait for a running update."""
        if self._told is None:
            with self._lock:
                if self._told is None:
                    self.refresh()
        return self._told or {}

    def _status_event(self) -> Event:
        """Record the progress, and return a message."""
        with self._lock:
            known = self._told or {}
            told: dict[str, Any] = {
                "campaign": self.number,
                "database": self.label,
                "name": self.name or known.get("name") or self.label.rpartition("/")[2],
                "problem": self._problem,
                "sequence": self.sequence,
                "checked": self._checked,
            }
            if self._store is not None and self._columns is not None:
                with suppress(StoreError):  # the next refresh reports it
                    found = CampaignStatus.of(self._store, self._columns.rows(STATUS_QUANTITIES), ())
                    told |= {"name": found.name, "reasons": self._reasons(self._columns)}
                    known = found.to_json()
            self._told = known | told
            return "status", self._told

    def records(self) -> bytes:
        """Return all cells (`CellColumns.packed`); empty as long as the database cannot be read."""
        with self._lock:
            if self._columns is None:
                self.refresh()
            return b"" if self._columns is None else self._columns.packed(self.sequence, self._shown)

    def cell(self, seed: int, content: float) -> dict[str, Any]:
        """Return signals, section, cement and path of one cell, as in the report.

        `UnknownCellError` if it has no outcome.
        """
        with self._lock:
            self._open()
            analysis = self._analyse()
            found = analysis.cell(seed, content)
            return {
                "cells": list(describe_cells(analysis, [found], self._graphs(analysis), {})),
                "sections": describe_sections(analysis, [found]),
            }

    def packing(self, index: int) -> dict[str, Any] | None:
        """Return a packing as in the report; None if none has that index.

        With the normal contact forces before the wave, in percent of the mean force, (M,).
        """
        with self._lock:
            self._open()
            graphs = self._graphs(self._analyse())
            if not 0 <= index < len(graphs):
                return None
            packing, (first, second) = graphs[index].packing, graphs[index].graph.pairs.T
            apart = np.hypot(packing.x[first] - packing.x[second], packing.y[first] - packing.y[second])
            overlap = packing.radius[first] + packing.radius[second] - apart
            force = Sand().hertz_coefficient(packing.radius[first], packing.radius[second]) * overlap**1.5
            percent = np.rint(100.0 * force / force.mean()).astype(int).tolist()
            return packing_block(self._analyse(), graphs[index]) | {"forces": percent}

    def _open(self) -> Store:
        """Return the store, opened again if its file was replaced."""
        path = Address.parse(self.database).path
        try:
            found = path.stat() if path is not None and path.exists() else None
            same = found is not None and self._file is not None and os.path.samestat(found, self._file)
            if self._store is not None and path is not None and not same:
                self.close()
            if self._store is None:
                self._store = read_campaign(self.database, self.name)
                self._file = found
        except OSError as error:  # a network that does not answer, a folder that is closed for a while
            raise StoreUnavailableError(
                f"{self.label} can't be read ({error.strerror}).", "It is tried again."
            ) from error
        return self._store

    def _analyse(self) -> CampaignAnalysis:
        """Return the maker of data of single cells; packings are read once."""
        store = self._open()
        if self._analysis is None or len(self._graphs(self._analysis)) != len(store.packing_indices()):
            self._analysis = CampaignAnalysis(store, None, with_patterns)
        return self._analysis

    @staticmethod
    def _graphs(analysis: CampaignAnalysis) -> tuple[PackingGraph, ...]:
        try:
            return analysis.graphs
        except UnavailableError:
            return ()

    def _refresh(self) -> list[Event]:
        store = self._open()
        events: list[Event] = []
        mark = store.mark()
        if self._columns is None or self._mark is None or mark.cells != self._mark.cells:
            self._begin(store)
            self._mark, self._read = mark, datetime.now(UTC)
            return [self._status_event()]  # longer work follows later, since users may wait for the first picture
        if mark != self._mark:
            events += self._take_new(store, self._mark)
            events.append(self._status_event())
        elif self._problem or self._run_state(store) != self._run:
            self._problem = ""
            events.append(self._status_event())
        self._mark, self._run, self._read = mark, self._run_state(store), datetime.now(UTC)
        if self._unchecked:
            before = self._checked
            self._check_some(store)
            if not self._unchecked or int(10 * self._checked) > int(10 * before):
                events.append(self._status_event())
        return events

    @staticmethod
    def _run_state(store: Store) -> tuple[bool, int, str | None]:
        """Whether a run is active, the last run, and its end."""
        holder, runs = store.lease_holder(), store.runs()
        return holder is not None and holder.may_live(), len(runs), runs[-1][1].exit_state if runs else None

    def _begin(self, store: Store) -> None:
        """Read all cells: first the velocities, then all columns piece by piece."""
        store.use_campaign(self.name)
        rows = store.table(("seed", "content", "status", "vs"))
        names = [name for name in QUANTITY_BY_NAME if name not in {"seed", "content"}]
        if len(rows["seed"]) > MOST_FULL_RECORDS:
            names = [name for name in names if name in {*SHORT_RECORD, *STATUS_QUANTITIES}]
        self._columns = CellColumns.empty(rows, names)
        self._columns.put(rows)
        self._problem = ""
        seeds = self._columns.seeds.tolist()
        # A query of 1,000 cells takes a tenth of a second.
        stride = max(1, 1000 // max(1, self._columns.contents.size))
        self._unchecked = [tuple(seeds[at : at + stride]) for at in range(0, len(seeds), stride)]
        self._changed()
        if len(self._unchecked) == 1:
            self._check_some(store)

    def _check_some(self, store: Store) -> None:
        """Read the next cells with all displayed quantities."""
        assert self._columns is not None  # noqa: S101 - it is there as soon as there are cells to check
        before = len(self._unchecked)
        seeds = self._unchecked.pop(0)
        self._columns.put(store.table(("seed", "content", *self._columns.values), Selection(seeds=seeds)))
        self._checked += (1.0 - self._checked) / before
        if not self._unchecked:
            self._changed()

    def _take_new(self, store: Store, before: StoreMark) -> list[Event]:
        """Read the cells recorded since the last update, or all cells if something else has changed."""
        assert self._columns is not None  # noqa: S101 - cells can only be new where there are others
        since = Selection(since=before.recorded) if before.recorded is not None else Selection()
        names = ("seed", "content", *self._columns.values)
        places = self._columns.put(store.table(names, since))
        if self._columns.settled() != store.settled():  # some are pending again, or were imported
            self._begin(store)
            return []
        if not places:
            return []
        # Of more than 1,000 changed cells the browser requests all.
        if len(places) > 1000 or set(self._columns.shown()) - set(self._shown):
            self._changed()
            return []
        self.sequence += 1
        told = {name: numbers_or_none(self._columns.values[name][places]) for name in self._shown}
        return [("cells", {"campaign": self.number, "sequence": self.sequence, "places": places, "columns": told})]

    def _changed(self) -> None:
        """Let browsers request all cells, which may have more quantities than before."""
        assert self._columns is not None  # noqa: S101 - as above
        self.sequence += 1
        self._shown = ["status", "reason", "vs"]
        self._shown += [name for name in self._columns.shown() if name not in self._shown]
        self._checked = 0.0 if self._unchecked else 1.0

    @staticmethod
    def _reasons(columns: CellColumns) -> list[dict[str, Any]]:
        content = columns.contents[[*range(columns.contents.size)] * columns.seeds.size]
        found = count_reasons(columns.values["status"], columns.values["reason"], content)
        return [
            {"outcome": outcome, "reason": reason, "contents": contents, "cells": count}
            for outcome, reason, contents, count in found
        ]
