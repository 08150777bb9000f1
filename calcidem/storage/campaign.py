"""Reading a campaign for analysis: read-only, and safe while a run writes."""

import json
import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any, NoReturn

import numpy as np
import pandas as pd
import xarray as xr

from calcidem.storage.errors import QueryError, UnknownCellError
from calcidem.storage.netcdf.dataset import campaign_dataset, cell_matrices
from calcidem.storage.records import (
    QUANTITY_BY_NAME,
    AttemptRecord,
    CampaignRecord,
    CellKey,
    CellResult,
    CellStatus,
    PackingRecord,
    RecordedSection,
    RunRecord,
    canonical_content,
)
from calcidem.storage.sql.store import Store, open_store
from calcidem.storage.store import Closable, Selection


def open_stored_campaign(path_or_url: str | os.PathLike[str], name: str | None = None) -> "StoredCampaign":
    """Open a campaign for reading; a run may go on writing it meanwhile.

    Parameters
    ----------
    path_or_url : str or path
        SQLite file or database URL.
    name : str, optional
        Which campaign, where the database has several.

    Raises
    ------
    StoreError
        If the database can't be read or has no such campaign (see `calcidem.storage.sql.store.open_store`).

    Examples
    --------
    >>> with open_stored_campaign("example.db") as campaign:
    ...     campaign.record.name
    'quick'
    """
    store = open_store(path_or_url, read_only=True)
    try:
        return StoredCampaign(store, store.use_campaign(name))
    except BaseException:
        store.close()
        raise


class StoredCampaign(Closable):
    """A campaign as its readers see it.

    Nothing is read before it is asked for, and every call sees the cells stored by then. It is a context
    manager.

    Attributes
    ----------
    store : Store
        With that campaign chosen; closed together with this object.
    record : CampaignRecord
    """

    def __init__(self, store: Store, record: CampaignRecord) -> None:
        self.store = store
        self.record = record

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled: connections end at the border of a process.

        Raises
        ------
        TypeError
            Always.
        """
        raise TypeError(
            f"The open campaign '{self.record.name}' cannot be pickled: give other processes the name of its file, "
            "and open it there with calcidem.open_campaign."
        )

    @property
    def config(self) -> dict[str, Any]:
        """The physical configuration."""
        config: dict[str, Any] = json.loads(self.record.config)
        return config

    def vs(self) -> xr.DataArray:
        """Return the shear-wave velocities (seed, content) in m/s, NaN where a cell isn't done.

        Examples
        --------
        >>> campaign = open_stored_campaign("example.db")
        >>> campaign.vs().sel(content=5.0).values
        array([1150., 1151.,   nan,   nan])
        """
        return cell_matrices(self.store, ("vs",))["vs"]

    def vs_error(self) -> xr.DataArray:
        """Return the relative standard errors (seed, content) of the velocities, NaN where they are not known.

        Each is made of the errors of reading and simulation (`reading_error`, `numerical_error` in `to_xarray`), and
        1.96 of them on either side of a velocity hold 95 %.

        Examples
        --------
        >>> campaign = open_stored_campaign("example.db")
        >>> campaign.vs_error().sel(content=5.0).values.round(4)
        array([0.012, 0.012,   nan,   nan])
        """
        return cell_matrices(self.store, ("vs_error",))["vs_error"]

    def to_xarray(self, columns: Sequence[str] | None = None) -> xr.Dataset:
        """Return scalar quantities of every cell (`calcidem.storage.netcdf.dataset.campaign_dataset`).

        Parameters
        ----------
        columns : sequence of str, optional
            Quantities, by default all.

        Examples
        --------
        >>> campaign = open_stored_campaign("example.db")
        >>> float(campaign.to_xarray()["steps"].sel(seed=0, content=5.0))
        12000.0
        """
        return campaign_dataset(self.store, self.record, columns)

    def to_dataframe(
        self,
        columns: Sequence[str] | None = None,
        *,
        content: float | Collection[float] | None = None,
        seed: int | Collection[int] | None = None,
        status: str | Collection[str] | None = None,
        where: str | None = None,
    ) -> "pd.DataFrame":
        """Return a pandas table with one row for each planned cell; parameters as in `select`.

        Parameters
        ----------
        columns : sequence of str, optional
            Quantities, by default all.

        Examples
        --------
        >>> campaign = open_stored_campaign("example.db")
        >>> campaign.to_dataframe(["seed", "vs"], content=5.0, status="done")
           seed      vs
        0     0  1150.0
        1     1  1151.0
        """
        import pandas as pd  # noqa: PLC0415 - takes half a second to import, and few callers need it

        names = list(QUANTITY_BY_NAME) if columns is None else list(columns)
        chosen = _selection(content, seed, status, where)
        self.refuse_unknown_contents(chosen.contents or ())
        frame = pd.DataFrame(self.store.table(names, chosen))
        # Int64 with a capital is the type of pandas for whole numbers some of which are missing.
        return frame.astype({name: "Int64" for name in names if QUANTITY_BY_NAME[name].kind == "whole"})

    def select(
        self,
        *,
        content: float | Collection[float] | None = None,
        seed: int | Collection[int] | None = None,
        status: str | Collection[str] | None = None,
        where: str | None = None,
        with_arrays: bool = False,
    ) -> Iterator[CellResult]:
        """Give the outcomes of the selected cells as frozen records, by seed, then content.

        Parameters
        ----------
        content : float or collection of float, optional
            Percent.
        seed : int or collection of int, optional
        status : str or collection of str, optional
            Such as ``"done"``.
        where : str, optional
            Filter such as ``"vs > 1500 and clusters >= 40"`` over `calcidem.storage.records.QUANTITY_BY_NAME`.
        with_arrays : bool
            Whether the records bring sections and cement patterns along.

        Returns
        -------
        iterator of CellResult
            Fetched as it is consumed.

        Raises
        ------
        UnknownCellError
            For a content that the campaign does not have.
        QueryError
            For an unknown status, or a filter that is none.

        Examples
        --------
        >>> campaign = open_stored_campaign("example.db")
        >>> [cell.key.seed for cell in campaign.select(content=5.0, where="vs > 1150")]
        [1]
        """
        chosen = _selection(content, seed, status, where)
        self.refuse_unknown_contents(chosen.contents or ())
        found = self.store.results(chosen, with_arrays=with_arrays)
        return self._complete(found) if with_arrays else found

    def _complete(self, outcomes: Iterator[CellResult]) -> Iterator[CellResult]:
        """Give outcomes with their arrays; a campaign that can draw cement which is not stored does so here."""
        return outcomes

    def refuse_unknown_contents(self, contents: Iterable[float]) -> None:
        """Raise an `UnknownCellError` that names the contents of this campaign if one of these is none of them."""
        present = self.record.contents
        if unknown := ", ".join(f"{content:g} %" for content in contents if canonical_content(content) not in present):
            there_are = ", ".join(f"{content:g}" for content in present)
            raise UnknownCellError(
                f"There is no content {unknown} in campaign '{self.record.name}'.", f"There are {there_are} %."
            )

    def cell(self, *, seed: int, content: float) -> CellResult:
        """Return the whole outcome of one cell, with its arrays.

        Raises
        ------
        UnknownCellError
            If the cell has no outcome.
        """
        key = CellKey(seed, content)
        self.refuse_unknown_contents([key.content])
        found = next(self.select(seed=key.seed, content=key.content, with_arrays=True), None)
        if found is None:
            raise UnknownCellError(
                f"The cell of seed {seed} and content {content} % has no outcome.",
                "See 'pending' in the status, or extend the campaign.",
            )
        return found

    def recorded_section(self, *, seed: int, content: float) -> RecordedSection:
        """Return the section of a cell as it is stored.

        Raises
        ------
        UnknownCellError
            If it was not kept.
        """
        found = next(self.store.results(Selection((seed,), (content,)), with_arrays=True), None)
        if found is not None:
            found.refuse_damage()
        if found is None or found.section is None:
            raise UnknownCellError(
                f"No section is stored for seed {seed} and content {content} %.",
                "Only cells that were computed with run.store_sections have one.",
            )
        return found.section

    def section(self, *, seed: int, content: float) -> xr.DataArray:
        """Return the space-time section of a cell: velocities [m/s] along (time, place, component).

        ``time`` is in s after the pulse began, ``place`` the path from the transmitter in m, the last of which is the
        receiver, and ``component`` is ``across`` the path or ``along`` it.

        Raises
        ------
        UnknownCellError
            If it was not kept.

        Examples
        --------
        >>> campaign = open_stored_campaign("example.db")
        >>> campaign.section(seed=1, content=5.0).sel(component="across").isel(place=-1).dims
        ('time',)
        """
        found = self.recorded_section(seed=seed, content=content)
        return xr.DataArray(
            np.stack([found.across, found.along], axis=-1) * found.resolution,
            dims=("time", "place", "component"),
            coords={
                "time": ("time", found.time, {"units": "s"}),
                "place": ("place", found.places, {"units": "m"}),
                "component": ["across", "along"],
            },
            name="velocity",
            attrs={"units": "m s-1", "pulse_frequency": found.pulse_frequency, "aperture": found.aperture},
        )

    def packing(self, index: int = 0) -> PackingRecord:
        """Return a packing of the campaign.

        Raises
        ------
        UnknownCellError
            If there is none of that index (yet).
        """
        found = self.store.load_packing(index)
        if found is None:
            raise UnknownCellError(f"Packing {index} is not stored.", f"Stored are: {self.packing_indices()}.")
        return found

    def packing_indices(self) -> tuple[int, ...]:
        """Return the indices of the packings that are stored, ascending."""
        return self.store.packing_indices()

    def status_counts(self) -> dict[tuple[float, CellStatus], int]:
        """Return how many planned cells each content (percent) has of each status; zeros are left out."""
        return self.store.status_counts()

    def runs(self) -> tuple[tuple[int, RunRecord], ...]:
        """Return the provenance of all runs with their numbers, oldest first."""
        return self.store.runs()

    def history(self, *, seed: int, content: float) -> tuple[AttemptRecord, ...]:
        """Return all attempts at a cell."""
        return tuple(self.store.history(Selection(seeds=(seed,), contents=(content,))))

    def close(self) -> None:
        """Release the connection."""
        self.store.close()


def _selection(
    content: float | Collection[float] | None,
    seed: int | Collection[int] | None,
    status: str | Collection[str] | None,
    where: str | None,
) -> Selection:
    return Selection(
        seeds=seed if isinstance(seed, Collection) or seed is None else (seed,),
        contents=content if isinstance(content, Collection) or content is None else (content,),
        statuses=None
        if status is None
        else [_known_status(s) for s in ((status,) if isinstance(status, str) else status)],
        where=where,
    )


def _known_status(status: str) -> CellStatus:
    """Return the status of that name; `QueryError` if there is none."""
    try:
        return CellStatus(status)
    except ValueError as error:
        raise QueryError(f"status = '{status}' is none.", f"Give one of {', '.join(CellStatus)}.") from error
