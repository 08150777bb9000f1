"""Groups ``attempts`` and ``packings`` of an exported file."""

import json
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from calcidem.storage.netcdf.groups import Group, append, counted_slices, optional_texts, read_columns, texts
from calcidem.storage.records import AttemptRecord, CellKey, PackingRecord

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND = timedelta(microseconds=1)
NO_NUMBER = -1  # stands for None in whole-number columns, all of whose real values are 0 or more

PACKING_NUMBERS = {
    "width": ("m", "width of the box"),
    "height": ("m", "height of the lid"),
    "porosity": ("1", "area of the voids over area of the box"),
    "coordination_number": ("1", "mean number of contacts of a grain"),
    "coordination_number_without_rattlers": ("1", "mean number of contacts of a grain that carries load"),
    "mean_overlap": ("1", "mean overlap over mean diameter"),
    "largest_overlap": ("1", "largest overlap over mean diameter"),
    "unbalanced_ratio": ("1", "mean unbalanced force over mean contact force"),
    "seconds": ("s", "computing time"),
}


def append_attempts(file: Group, attempts: Sequence[AttemptRecord]) -> None:
    """Append attempts to the group ``attempts``."""
    recorded = [(attempt.recorded - EPOCH) // MICROSECOND for attempt in attempts]
    seconds = [np.nan if attempt.seconds is None else attempt.seconds for attempt in attempts]
    columns = {
        "seed": ("1", "seed of the cell", np.array([a.key.seed for a in attempts], dtype=np.int64)),
        "content": ("percent", "calcite content of the cell", np.array([a.key.content for a in attempts])),
        "number": ("1", "number of the attempt", np.array([a.number for a in attempts], dtype=np.int32)),
        "run": ("1", "number of the run", _whole([a.run_id for a in attempts])),
        "outcome": ("", "outcome", texts([a.outcome for a in attempts])),
        "reason": ("", "why", texts([a.reason for a in attempts])),
        "rank": ("1", "MPI rank", _whole([a.rank for a in attempts])),
        "host": ("", "host", texts([a.host for a in attempts])),
        "seconds": ("s", "computing time", np.array(seconds)),
        "recorded": (
            "microseconds since 1970-01-01T00:00:00Z",
            "time of storing",
            np.array(recorded, dtype=np.int64),
        ),
        "forgiven": (
            "1",
            "1 if a retry came after it",
            np.array([a.forgiven for a in attempts], dtype=np.int8),
        ),
    }
    append(file.createGroup("attempts"), "attempt", columns)


def _whole(values: Iterable[int | None]) -> "np.ndarray[tuple[int], np.dtype[np.int32]]":
    return np.array([NO_NUMBER if value is None else value for value in values], dtype=np.int32)


def read_attempts(file: Group, run_numbers: dict[int, int]) -> Iterator[AttemptRecord]:
    """Read the group ``attempts``.

    Parameters
    ----------
    file : netCDF4.Dataset
    run_numbers : dict of int to int
        From the numbers of runs in the file to those in the store.
    """
    if "attempts" not in file.groups:
        return
    columns = read_columns(file.groups["attempts"], "attempt")
    hosts = optional_texts(columns["host"])
    for i, host in enumerate(hosts):
        run, rank, seconds = int(columns["run"][i]), int(columns["rank"][i]), float(columns["seconds"][i])
        yield AttemptRecord(
            key=CellKey(int(columns["seed"][i]), float(columns["content"][i])),
            number=int(columns["number"][i]),
            outcome=str(columns["outcome"][i]),
            reason=str(columns["reason"][i]),
            rank=None if rank == NO_NUMBER else rank,
            host=host,
            seconds=None if np.isnan(seconds) else seconds,
            recorded=EPOCH + int(columns["recorded"][i]) * MICROSECOND,
            run_id=None if run == NO_NUMBER else run_numbers[run],
            forgiven=bool(columns["forgiven"][i]),
        )


def append_packing(file: Group, packing: PackingRecord) -> None:
    """Append a packing to the group ``packings``."""
    group = file.createGroup("packings")
    state = np.frombuffer(packing.state, dtype=np.uint8)
    columns = {
        "index": ("1", "index of the packing", np.array([packing.index], dtype=np.int32)),
        "hash": ("", "hash of what it was made from", texts([packing.hash])),
        "wall_stress": (
            "",
            "normal stress on each wall in Pa, as JSON",
            texts([json.dumps(dict(packing.wall_stress))]),
        ),
        "grain_count": ("1", "number of grains", np.array([packing.radius.size], dtype=np.int64)),
        "state_byte_count": ("1", "bytes of the complete state", np.array([state.size], dtype=np.int64)),
    }
    numbers = {
        name: (unit, meaning, np.array([getattr(packing, name)])) for name, (unit, meaning) in PACKING_NUMBERS.items()
    }
    append(group, "packing", columns | numbers)
    grains = {
        "x": ("m", "horizontal position of the centre", packing.x),
        "y": ("m", "vertical position of the centre", packing.y),
        "radius": ("m", "radius", packing.radius),
    }
    append(group, "grain", grains)
    append(group, "state_byte", {"state": ("1", "complete state, a NumPy .npz file", state)})


def read_packings(file: Group) -> Iterator[PackingRecord]:
    """Read the group ``packings``."""
    if "packings" not in file.groups:
        return
    group = file.groups["packings"]
    columns = read_columns(group, "packing")
    grains, states = counted_slices(columns["grain_count"]), counted_slices(columns["state_byte_count"])
    for i, (of_grains, of_state) in enumerate(zip(grains, states, strict=True)):
        values: dict[str, Any] = {name: float(columns[name][i]) for name in PACKING_NUMBERS}
        values |= read_columns(group, "grain", of_grains)
        yield PackingRecord(
            index=int(columns["index"][i]),
            hash=str(columns["hash"][i]),
            wall_stress=json.loads(columns["wall_stress"][i]),
            state=read_columns(group, "state_byte", of_state)["state"].tobytes(),
            **values,
        )
