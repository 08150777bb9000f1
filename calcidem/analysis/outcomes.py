"""Separate counts of measured, failed and missing cells in a matrix of seeds and contents."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from calcidem.storage.records import NOT_PLANNED, STATUS_CODES, CellStatus

_REPEATED = "repeated"


def count_outcomes(vs: xr.DataArray, status: xr.DataArray | None = None) -> xr.Dataset:
    """Count the cells of each content by outcome.

    A cell that was not computed yet carries no information about Vs. A failed cell may, since the arrival of slow
    samples is hard to pick. The two are therefore never added. Without cement all seeds are one sample and count once.

    Both arguments are along (seed, content): Vs in m/s, NaN if missing, and the outcome as text. It is "done" if Vs is
    a number, "" if the cell was not computed, and else the name of the failure. Without `status` every NaN counts as
    not computed. Returns `measured`, `missing` and `failed` along content, and `failures` along (outcome, content).
    `ValueError` if `vs` has other dimensions, an infinite value, or disagrees with `status`.
    """
    vs = arrange_matrix(vs)
    measured = np.isfinite(vs.to_numpy())
    text = np.where(measured, "done", "") if status is None else _check_status(vs, status, measured)
    for column in np.flatnonzero(vs["content"].to_numpy() == 0.0):
        best = max(range(len(text)), key=lambda seed: (text[seed, column] == "done", text[seed, column] != ""))
        text = text.copy()
        text[np.arange(len(text)) != best, column] = _REPEATED
        measured[np.arange(len(text)) != best, column] = False
    names = sorted(set(text.ravel().tolist()) - {"done", "", _REPEATED})
    failures = np.array([(text == name).sum(axis=0) for name in names], dtype=np.int64)
    failures = failures.reshape(len(names), vs.sizes["content"])
    return xr.Dataset(
        {
            "measured": ("content", measured.sum(axis=0)),
            "missing": ("content", (text == "").sum(axis=0)),
            "failed": ("content", failures.sum(axis=0)),
            "failures": (("outcome", "content"), failures),
        },
        coords={"content": vs["content"], "outcome": np.array(names, dtype=str)},
    )


def name_outcomes(codes: xr.DataArray) -> xr.DataArray:
    """Outcome of each cell as text along (seed, content), from its `STATUS_CODES`; empty if there is none."""
    names = np.full(max(STATUS_CODES.values()) + 1, "", dtype=object)
    for name, code in STATUS_CODES.items():
        if name not in (CellStatus.PENDING, NOT_PLANNED):
            names[code] = str(name)
    return xr.DataArray(names[codes.to_numpy()], codes.coords, codes.dims)


def arrange_matrix(vs: xr.DataArray) -> xr.DataArray:
    """Return `vs` along (seed, content); `ValueError` if it has other dimensions or holds an infinite value."""
    if set(vs.dims) != {"seed", "content"}:
        raise ValueError(f"vs has the dimensions {vs.dims}; give it the dimensions ('seed', 'content')")
    if bool(np.isinf(vs).any()):
        raise ValueError("vs holds infinite values; put NaN where a cell has no velocity")
    return vs.transpose("seed", "content")


def _check_status(vs: xr.DataArray, status: xr.DataArray, measured: NDArray[np.bool_]) -> NDArray[np.object_]:
    if dict(status.sizes) != dict(vs.sizes):
        raise ValueError(f"status has shape {dict(status.sizes)}, vs {dict(vs.sizes)}; make them equal")
    text = status.transpose("seed", "content").to_numpy().astype(object)
    wrong = np.argwhere((text == "done") != measured)
    if wrong.size:
        row, column = wrong[0]
        seed, content = vs["seed"].to_numpy()[row], vs["content"].to_numpy()[column]
        raise ValueError(
            f"seed {seed} at {content} %: status is {text[row, column]!r} but vs is "
            f"{vs.to_numpy()[row, column]}; vs must be a number exactly where status is 'done'"
        )
    return text
