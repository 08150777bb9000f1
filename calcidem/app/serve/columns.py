"""Columns of a campaign's cells in memory: a matrix of seeds and contents, filled by rows of the store."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from calcidem.app.report.cell_data import describe_axes, numbers_or_none
from calcidem.app.report.wording import EXCEPTIONAL
from calcidem.ends import CellStatus
from calcidem.storage.records import QUANTITY_BY_NAME


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
            found = _as_kept(name, rows[name])
            old = self.values[name][places]
            same = old == found
            if not _holds_texts(name):
                same |= np.isnan(old) & np.isnan(found)
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
        return [name for name, column in self.values.items() if _tells(name, column)]

    def described(self, places: Sequence[int], names: Sequence[str]) -> dict[str, list[Any]]:
        """Return quantities of some cells for JSON."""
        return {name: numbers_or_none(self.values[name][list(places)]) for name in names}

    def packed(self, sequence: int, names: Sequence[str]) -> bytes:
        """Return all cells as bytes: the length of a header, the header as JSON, and the columns that it describes.

        A number has four bytes if these suffice for display, else eight. A text is an index into the few different
        texts. So 100,000 cells are a few megabytes, which a browser need not parse.
        """
        arrays, described, offset = [], [], 0
        for name in names:
            kind, array, texts = _as_array(name, self.values[name])
            data = array.tobytes()
            data += bytes(-len(data) % 8)  # typed arrays of browsers begin at multiples of their element size
            described.append({"name": name, "type": kind, "offset": offset, "texts": texts})
            arrays.append(data)
            offset += len(data)
        axes = describe_axes(self.seeds, self.contents, [name for name in names if name in QUANTITY_BY_NAME])
        header = json.dumps({"sequence": sequence, "columns": described} | axes, allow_nan=False).encode()
        header += b" " * (-(len(header) + 4) % 8)
        return b"".join([len(header).to_bytes(4, "little"), header, *arrays])


def _holds_texts(name: str) -> bool:
    return QUANTITY_BY_NAME[name].kind == "text"


def _as_kept(name: str, column: NDArray[Any]) -> NDArray[Any]:
    """Values in the form of this class."""
    if not _holds_texts(name):
        return column.astype(np.float64)
    texts = np.array([text or "" for text in column.tolist()], dtype=object)
    if name == "status":
        texts[texts == CellStatus.PENDING.value] = ""
    return texts


def _tells(name: str, column: NDArray[Any]) -> bool:
    if _holds_texts(name):
        return bool(np.any(column != ""))
    known = column[np.isfinite(column)]
    return bool(known.size and (name not in EXCEPTIONAL or np.any(known)))


def _as_array(name: str, column: NDArray[Any]) -> tuple[str, NDArray[Any], list[str]]:
    """Type of a browser's array, the array, and the texts that it indexes."""
    if _holds_texts(name):
        texts = {text: place for place, text in enumerate(dict.fromkeys(column.tolist()))}
        return "Uint32", np.array([texts[text] for text in column.tolist()], dtype="<u4"), list(texts)
    if QUANTITY_BY_NAME[name].kind == "whole":
        return "Float64", column.astype("<f8"), []
    return "Float32", column.astype("<f4"), []
