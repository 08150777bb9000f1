"""Progress of a campaign: status of its cells, statistics, time left, repeated and failed cells."""

import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import compress
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from calcidem.analysis.intervals import Interval
from calcidem.analysis.velocity import BUDGET_QUANTITIES, ErrorBudget, are_samples, error_budget
from calcidem.ends import CellStatus
from calcidem.storage.passwords import hide_passwords
from calcidem.storage.records import CellKey, RunRecord
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.storage.store import Selection

STATUS_QUANTITIES = ("seed", "content", "status", "seconds", *BUDGET_QUANTITIES)
"""Quantities of each cell that the status needs."""

_TROUBLES = (
    *(CellStatus.QUARANTINED, CellStatus.FAILED, CellStatus.TIMED_OUT, CellStatus.UNSTABLE, CellStatus.NO_ARRIVAL),
)
"""Outcomes other than done, the most severe first."""

_TROUBLE_NAMES = frozenset(status.value for status in _TROUBLES)

UNREAD = (CellStatus.NO_ARRIVAL, CellStatus.UNSTABLE)
"""Outcomes without a velocity that a new computation would repeat."""

_MOST_TIMED = 20_000
"""Number of cells whose computing times are read, enough for a mean at each content."""

_STATUS_BY_NAME = {status.value: status for status in CellStatus}

FEWEST_TO_PLAN = 3
"""Number of velocities below which a standard deviation has no meaning."""

URGENCY = {status: place for place, status in enumerate((*_TROUBLES, CellStatus.PENDING, CellStatus.DONE))}
"""Rank of each status, the most severe first; pending before done."""


@dataclass(frozen=True, slots=True, eq=False)
class ContentStatus:
    """Progress of the cells of one content."""

    content: float
    """Percent."""
    statuses: Mapping[int, CellStatus]
    """Status by seed."""
    counts: Mapping[CellStatus, int]
    """Number of cells by status."""
    vs: NDArray[np.float64]
    """Velocities of its distinct samples, m/s."""
    mean: float
    deviation: float
    """Mean and standard deviation of these, m/s; NaN with too few."""
    interval: Interval
    """95 % interval of the mean for further seeds of the packing, m/s, by Student's t; without cement by the error."""
    budget: ErrorBudget
    """Errors of its velocities."""
    seconds_per_cell: float
    """Mean computing time of a cell so far; NaN before the first."""
    seconds_left: float
    """Computing time of the pending cells on one core; NaN if none was measured."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """A cell that failed, or that needed several attempts."""

    key: CellKey
    status: CellStatus
    """The cell and its present status."""
    attempts: int
    losses: int
    """Number of attempts, and of workers lost since the last retry."""
    reason: str
    """First line of the reason; empty for a done or pending cell."""
    retry: str = ""
    """Reason why its sample was computed again with half the step; else empty."""


@dataclass(frozen=True, slots=True)
class CampaignStatus:
    """Progress of a campaign."""

    name: str
    hash: str
    content_hashes: Mapping[int, str]
    """Content hashes of its packings, by index; None if unknown."""
    seeds: tuple[int, ...]
    contents: tuple[ContentStatus, ...]
    """One for each content, ascending."""
    counts: Mapping[CellStatus, int]
    """Number of cells by status."""
    budget: ErrorBudget
    """Errors of all velocities."""
    troubles: tuple[Trouble, ...]
    """Cells that failed, were repeated, or needed half the step."""
    last_run: RunRecord | None
    run_number: int | None
    """Latest run, if any."""
    running: bool
    """Whether a process writes the campaign now, as far as known."""
    workers: int
    """Number of computing ranks in the latest run."""
    seconds_left: float
    """Time until all cells are settled on this number of workers; NaN if none was measured."""

    @property
    def pending(self) -> int:
        """Number of cells without an outcome."""
        return self.counts.get(CellStatus.PENDING, 0)

    def to_json(self) -> dict[str, Any]:
        """How far it is in JSON's types, without single cells; a number that is not known is None."""
        run = self.last_run
        return {
            "campaign": self.name,
            "hash": self.hash,
            "running": self.running,
            "run": run
            and {
                "number": self.run_number,
                "host": run.host,
                "ranks": run.ranks,
                "started": f"{run.started:%Y-%m-%d %H:%M} UTC",
                "exit_state": run.exit_state and hide_passwords(run.exit_state),
            },
            "cells": _by_name(self.counts),
            "vs_error": _finite_or_none(self.budget.total),
            "reading_error": _finite_or_none(self.budget.reading),
            "numerical_error": _finite_or_none(self.budget.numerical),
            "seconds_left": _finite_or_none(self.seconds_left),
            "workers": self.workers,
            "contents": [
                {
                    "content": one.content,
                    "cells": _by_name(one.counts),
                    "mean": _finite_or_none(one.mean),
                    "sd": _finite_or_none(one.deviation),
                    "reading_scatter": _finite_or_none(one.budget.scatter),
                    "loud": one.budget.loud,
                    "interval_95": [_finite_or_none(one.interval.low), _finite_or_none(one.interval.high)],
                    "seconds_per_cell": _finite_or_none(one.seconds_per_cell),
                    "core_seconds_left": _finite_or_none(one.seconds_left),
                }
                for one in self.contents
            ],
        }

    @classmethod
    def of(cls, store: Store, columns: Mapping[str, NDArray[Any]], troubles: tuple[Trouble, ...]) -> Self:
        """Progress of a campaign, in a few short queries, from `STATUS_QUANTITIES` of its planned cells."""
        contents = np.array(sorted(set(columns["content"].tolist())))
        rows = [columns["content"] == content for content in contents]
        seconds = [_mean_or_nan(columns["seconds"][row].astype(float)) for row in rows]
        expected = _expected_seconds(contents, np.array(seconds))
        statuses = tuple(
            _content_status(float(content), {name: values[row] for name, values in columns.items()}, measured, cost)
            for content, row, measured, cost in zip(contents, rows, seconds, expected, strict=True)
        )
        counts: Counter[CellStatus] = Counter()
        for status in statuses:
            counts.update(status.counts)
        runs = store.runs()
        number, last = runs[-1] if runs else (None, None)
        workers = max(1, last.ranks - 1) if last is not None else 1
        return cls(
            name=store.record.name,
            hash=store.record.hash,
            content_hashes=store.content_hashes(),
            seeds=store.record.seeds,
            contents=statuses,
            counts=counts,
            budget=error_budget(columns),
            troubles=troubles,
            last_run=last,
            run_number=number,
            running=_is_being_written(store),
            workers=workers,
            seconds_left=sum(status.seconds_left for status in statuses) / workers,
        )

    @classmethod
    def read(cls, database: str | os.PathLike[str], campaign_name: str | None = None) -> Self:
        """Present progress of a stored campaign; `StoreError` if the database is unreadable or lacks the campaign."""
        with read_campaign(database, campaign_name) as store:
            columns = store.table([name for name in STATUS_QUANTITIES if name != "seconds"])
            columns["seconds"] = _sampled_seconds(store, columns)
            return cls.of(store, columns, _troubles_of(store, columns))


def _by_name(counts: Mapping[CellStatus, int]) -> dict[str, int]:
    return {str(status): number for status, number in sorted(counts.items())}


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _sampled_seconds(store: Store, columns: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """Computing time of each cell, s; in a large campaign only of some seeds, else NaN.

    They are read in a separate query, since they belong to attempts.
    """
    seconds = np.full(len(columns["seed"]), np.nan)
    seeds = np.unique(columns["seed"][columns["status"] != CellStatus.PENDING.value])
    chosen = seeds[:: max(1, math.ceil(len(seconds) / _MOST_TIMED))]
    found = store.table(("seconds",), Selection(chosen.tolist()))["seconds"]
    places = np.isin(columns["seed"], chosen)
    if np.count_nonzero(places) == len(found):  # otherwise cells were planned meanwhile
        seconds[places] = found
    return seconds


def _content_status(
    content: float, columns: Mapping[str, NDArray[Any]], measured: float, expected: float
) -> ContentStatus:
    """Progress of one content, from the columns of its cells and the measured and expected seconds of a cell."""
    names = columns["status"].tolist()
    found = dict(zip(columns["seed"].astype(int).tolist(), map(_STATUS_BY_NAME.__getitem__, names), strict=True))
    counts = Counter({_STATUS_BY_NAME[name]: count for name, count in Counter(names).items()})
    counted = are_samples(columns["vs"], content)
    vs = columns["vs"][counted].astype(float)
    is_one = content == 0.0  # without cement all seeds are the same sample
    pending = counts[CellStatus.PENDING]
    return ContentStatus(
        content=content,
        statuses=found,
        counts=counts,
        vs=vs,
        mean=_mean_or_nan(vs),
        deviation=float(np.std(vs, ddof=1)) if vs.size > 1 else np.nan,
        interval=Interval.of_velocity(vs[0], columns["vs_error"][counted][0])
        if is_one and vs.size
        else Interval.of_mean(vs),
        budget=error_budget(columns),
        seconds_per_cell=measured,
        seconds_left=(1 if is_one else pending) * expected if pending else 0.0,
    )


def _mean_or_nan(values: NDArray[np.float64]) -> float:
    """Mean of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else np.nan


def _expected_seconds(contents: NDArray[np.float64], measured: NDArray[np.float64]) -> NDArray[np.float64]:
    """Seconds of a cell at each content: measured, or interpolated between measured contents; both (C,)."""
    known = np.isfinite(measured)
    if not known.any():
        return np.full(contents.shape, np.nan)
    return np.interp(contents, contents[known], measured[known])


def _troubles_of(store: Store, columns: Mapping[str, NDArray[Any]]) -> tuple[Trouble, ...]:
    """Failed cells, the most severe first, then repeated ones."""
    names = columns["status"].tolist()

    def statuses_where(condition: Iterable[object]) -> dict[CellKey, CellStatus]:
        places = list(compress(range(len(names)), condition))
        keys = map(CellKey, columns["seed"][places].tolist(), columns["content"][places].tolist())
        return {key: CellStatus(names[place]) for key, place in zip(keys, places, strict=True)}

    statuses = statuses_where(name in _TROUBLE_NAMES for name in names)

    def texts(quantity: str, selection: Selection) -> dict[CellKey, str]:
        found = store.table(("seed", "content", quantity), selection)
        keys = map(CellKey, found["seed"].tolist(), found["content"].tolist())
        return {key: str(text or "").partition("\n")[0] for key, text in zip(keys, found[quantity], strict=True)}

    reasons = texts("reason", Selection(statuses=_TROUBLES))
    retries = texts("retry", Selection(where="retry is not None"))
    attempts = store.attempt_counts()
    attempts |= store.attempt_counts((statuses.keys() | retries.keys()) - attempts.keys())
    if others := {(key.seed, key.content) for key in attempts.keys() - statuses.keys()}:
        cells = zip(columns["seed"].tolist(), columns["content"].tolist(), strict=True)
        statuses |= statuses_where(cell in others for cell in cells)
    found = [
        Trouble(
            key,
            statuses[key],
            count.attempts,
            count.losses,
            reasons.get(key) or ("its attempt is missing" if statuses[key] in _TROUBLES else ""),
            retries.get(key, ""),
        )
        for key, count in attempts.items()
        if key in statuses  # otherwise it was planned meanwhile
    ]
    return tuple(sorted(found, key=lambda trouble: (URGENCY[trouble.status], trouble.key)))


def _is_being_written(store: Store) -> bool:
    """Whether a living process holds the lease of a campaign.

    A process on another machine counts as living until its heartbeat is five minutes old.
    """
    holder = store.lease_holder()
    return holder is not None and holder.may_live()
