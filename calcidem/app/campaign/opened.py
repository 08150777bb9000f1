"""A stored campaign and results computed from it: statistics, graphs, and samples to simulate or export.

The numbers of the paper's campaign, which the package contains, can be loaded without a database.
"""

import math
import os
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from html import escape
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn, Self

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from calcidem.analysis.campaign_analysis import CampaignAnalysis, dispersion_of_cells
from calcidem.analysis.distribution import describe_contents, tabulate
from calcidem.analysis.fits import FEWEST_ROWS, Prediction, VelocityPredictor, check_samples
from calcidem.analysis.intervals import Interval
from calcidem.analysis.packing_graph import Feature, PackingGraph, installed_features
from calcidem.analysis.velocity import (
    BUDGET_QUANTITIES,
    NOTE_QUANTITIES,
    Dispersion,
    damping_ratio,
    notes_on,
    small_strain_modulus,
)
from calcidem.app.campaign.packing import pattern_of, stored_experiment, with_patterns
from calcidem.dem.engine.scene import Bonds, Scene
from calcidem.dem.kernels.layout import Flags, Floats, Integers
from calcidem.dem.sample.cement import CementCapacityError, CementKind
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment, wave_scene
from calcidem.ends import CellStatus
from calcidem.storage.dataset import campaign_dataset
from calcidem.storage.errors import QueryError, StoreError, UnknownCellError
from calcidem.storage.files import write_atomically
from calcidem.storage.records import (
    QUANTITY_BY_NAME,
    AttemptRecord,
    CampaignRecord,
    CellResult,
    CementPattern,
    PackingRecord,
    RecordedSection,
    RunRecord,
    Selection,
    depends_on_pulse,
)
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.wording import pluralize

if TYPE_CHECKING:
    import networkx as nx

    from calcidem.app.campaign.plots import CampaignPlots
    from calcidem.dem.wave.static_speed import StaticSpeed  # loads the engine


SUFFIXES = (".vtu", ".csv")
"""Formats of the file of a sample."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A cemented sample, ready for `calcidem.dem`.

    Attributes
    ----------
    seed, content
        Its identity; content in percent of the sand's mass.
    packing
        Disks, contacts and their shear forces.
    kind
        (C,) cement of each of ``packing.pairs``, see `calcidem.dem.sample.cement.CementKind`.
    scene
        Packing between transmitter and receiver, with its bonds, in the state before the pulse. Start it with
        ``calcidem.dem.start(sample.scene, preload=sample.packing.preload)``.
    """

    seed: int
    content: float
    packing: Packing
    kind: npt.NDArray[np.uint8]
    scene: Scene

    @property
    def bonds(self) -> Bonds | None:
        """Bonds of the cemented contacts; None without any."""
        return self.scene.bonds

    def write(self, file: Path) -> Path:
        """Write it atomically: ``.vtu`` for ParaView, ``.csv`` for its disks alone.

        `ValueError` for another ending, `StoreError` if the library for VTK is not installed.
        """
        suffix = file.suffix.lower()
        if suffix not in SUFFIXES:
            raise ValueError(f"{file} ends with '{suffix}': give it one of the endings {', '.join(SUFFIXES)}")
        with write_atomically(file) as temporary:
            if suffix == ".csv":
                from calcidem.dem.sample.compaction import write_disks_csv  # noqa: PLC0415 - loads the engine

                write_disks_csv(self.packing.x, self.packing.y, self.packing.radius, temporary)
            else:
                _write_vtu(self, temporary)
        return file


def open_campaign(path_or_url: str | os.PathLike[str], name: str | None = None) -> "Campaign":
    """Open a campaign for reading; a run may write it meanwhile.

    Give the name if the SQLite file or database URL has several campaigns. `StoreError` if it cannot be read or has no
    such campaign.

    Examples
    --------
    >>> with open_campaign("quick.db") as campaign:
    ...     vs = campaign.vs()
    >>> vs.sizes["content"], vs.attrs["units"]
    (5, 'm s-1')
    """
    return Campaign(read_campaign(path_or_url, name))


class Campaign:
    """An opened campaign: its stored data and results computed from them.

    Every call reads the cells stored at that time. The campaign is a context manager.

    Attributes
    ----------
    store : Store
        Store with this campaign chosen; closed together with this object.
    """

    def __init__(self, store: Store) -> None:
        self.store = store

    @property
    def record(self) -> CampaignRecord:
        """Identity, configuration and plan at the time of opening."""
        return self.store.record

    def __reduce__(self) -> NoReturn:
        """Raise a `TypeError`, since connections cannot be sent to other processes."""
        raise TypeError(
            f"The open campaign '{self.record.name}' cannot be pickled: give other processes the name of its file, "
            "and open it there with calcidem.open_campaign."
        )

    @property
    def config(self) -> dict[str, Any]:
        """Physical configuration."""
        return self.record.parameters

    def vs(self) -> xr.DataArray:
        """Return the shear-wave velocities (seed, content) in m/s, NaN for cells that are not done.

        Examples
        --------
        >>> campaign = open_campaign("quick.db")
        >>> campaign.vs().sel(content=5.0).attrs["units"]
        'm s-1'
        """
        return self.to_xarray(("vs",))["vs"]

    def vs_error(self) -> xr.DataArray:
        """Return the relative standard errors (seed, content) of the velocities, NaN where unknown.

        They combine reading, simulation and pulse (`reading_error`, `numerical_error` and `pulse_effect` in
        `to_xarray`). The 95 % interval of a velocity extends 1.96 of them to either side.
        """
        return self.to_xarray(("vs_error",))["vs_error"]

    def to_xarray(self, columns: Sequence[str] | None = None) -> xr.Dataset:
        """Return these quantities of every cell, by default all (`calcidem.storage.dataset.campaign_dataset`)."""
        return campaign_dataset(self.store, columns)

    def to_dataframe(
        self,
        columns: Sequence[str] | None = None,
        *,
        content: float | Collection[float] | None = None,
        seed: int | Collection[int] | None = None,
        status: str | Collection[str] | None = None,
        where: str | None = None,
    ) -> pd.DataFrame:
        """Return a pandas table with one row for each planned cell; parameters as in `to_xarray` and `select`.

        Examples
        --------
        >>> campaign = open_campaign("quick.db")
        >>> campaign.to_dataframe(["seed", "vs"], content=5.0, status="done")["seed"].tolist()
        [1, 2, 3, 4, 5, 6, 7, 8]
        """
        names = list(QUANTITY_BY_NAME) if columns is None else list(columns)
        frame = pd.DataFrame(self.store.table(names, Selection(seed, content, status, where)))
        # Int64 with a capital is the type of pandas for whole numbers with missing values.
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
        """Yield the outcomes of the selected cells as frozen records, by seed, then content.

        Contents are in percent, statuses such as ``"done"``. ``where`` is a filter over
        `calcidem.storage.records.QUANTITY_BY_NAME` such as ``"vs > 1500 and clusters >= 40"``. ``with_arrays`` also
        loads sections and cement patterns. `UnknownCellError` for a content that the campaign does not have,
        `QueryError` for an unknown status or an invalid filter.

        Examples
        --------
        >>> campaign = open_campaign("quick.db")
        >>> [cell.key.seed for cell in campaign.select(content=5.0, where="seed < 3")]
        [1, 2]
        """
        found = self.store.results(Selection(seed, content, status, where), with_arrays=with_arrays)
        return with_patterns(self.store, found) if with_arrays else found

    def cell(self, *, seed: int, content: float) -> CellResult:
        """Return the outcome of one cell with its arrays; `UnknownCellError` if it has none."""
        return next(with_patterns(self.store, [self.store.cell(seed=seed, content=content)]))

    def recorded_section(self, *, seed: int, content: float) -> RecordedSection:
        """Return the stored section of a cell; `UnknownCellError` if it was not stored."""
        found = self.store.cell(seed=seed, content=content)
        if found.section is None:
            raise UnknownCellError(
                f"No section is stored for seed {seed} and content {content} %.",
                "Only cells that were computed with run.store_sections have one.",
            )
        return found.section

    def section(self, *, seed: int, content: float) -> xr.DataArray:
        """Return the space-time section of a cell: velocities [m/s] along (time, place, component).

        ``time`` is in s after the pulse began, ``place`` the path from the transmitter in m (last the receiver), and
        ``component`` is ``across`` or ``along`` the path. `UnknownCellError` if it was not stored.

        Examples
        --------
        >>> campaign = open_campaign("quick.db")
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
            attrs={"units": "m s-1", "pulse_frequency": found.pulse_frequency},
        )

    def packing(self, index: int = 0) -> PackingRecord:
        """Return a packing of the campaign; `UnknownCellError` if none is stored under that index."""
        return self.store.packing(index)

    def packing_indices(self) -> tuple[int, ...]:
        """Return the indices of the stored packings, ascending."""
        return self.store.packing_indices()

    def status_counts(self) -> dict[tuple[float, CellStatus], int]:
        """Return the number of planned cells of each content (percent) and status; zeros are left out."""
        return self.store.status_counts()

    def runs(self) -> tuple[tuple[int, RunRecord], ...]:
        """Return the provenance of all runs with their numbers, oldest first."""
        return self.store.runs()

    def history(self, *, seed: int, content: float) -> tuple[AttemptRecord, ...]:
        """Return all attempts at a cell."""
        return tuple(self.store.history(Selection(seed, content)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the connection."""
        self.store.close()

    def __repr__(self) -> str:
        """Name, size, and present numbers of cells by outcome."""
        counts: Counter[str] = Counter()
        with suppress(StoreError):  # it is closed
            for (_, status), number in self.status_counts().items():
                counts[status.words] += number
        size = f"{len(self.record.seeds)} seeds x {len(self.record.contents)} contents"
        cells = ", ".join(f"{number} {name}" for name, number in sorted(counts.items()))
        return f"<calcidem campaign '{self.record.name}': {size}; cells: {cells or 'not readable any more'}>"

    def _repr_html_(self) -> str:
        """The same with a table of Vs at each content for notebooks."""
        head = f"<p>{escape(repr(self)[1:-1])}</p>"
        try:
            found = self.summary()[["n", "missing", "failed", "mean", "standard_deviation"]].to_dataframe()
        except StoreError:
            return head
        found = found.rename(columns={"mean": "mean, m/s", "standard_deviation": "sd, m/s"}).rename_axis("content, %")
        return head + found.to_html(float_format=lambda value: f"{value:.1f}")

    @property
    def notes(self) -> tuple[str, ...]:
        """Advice about the velocities, such as waves too short for the grains, a sentence each; empty without any."""
        return tuple(notes_on(self.store.table(NOTE_QUANTITIES)))

    def summary(self, level: float = 0.95) -> xr.Dataset:
        """Return the distribution of Vs at each content, with intervals at a level.

        Along content, intervals also along bound: n, missing, failed, mean, standard deviation (m/s), skewness,
        kurtosis, Jarque-Bera test, confidence and prediction intervals. They are over distinct samples with a velocity:
        without cement all seeds are one sample, and the interval is that of its error. Intervals cover the seeds of one
        packing. Errors of the velocities are medians of the relative standard errors, and the standard deviation by
        reading errors alone (m/s), see `calcidem.analysis.velocity`.

        Examples
        --------
        >>> campaign = open_campaign("quick.db")
        >>> summary = campaign.summary().sel(content=5.0)
        >>> int(summary.n), 1000.0 < float(summary["mean"]) < 2000.0
        (8, True)
        >>> bool(summary.mean_interval[0] < summary["mean"] < summary.mean_interval[1])
        True
        """
        # In a large campaign these are a small part of the data of `to_xarray`.
        cells = self.to_xarray((*BUDGET_QUANTITIES, "status"))
        return tabulate(describe_contents(cells, level))

    def small_strain_modulus(self, density: float | None = None) -> xr.DataArray:
        """Return the shear moduli G0 = rho c^2 (Eq. 1) of the effective velocities along (seed, content) in Pa.

        NaN for cells without one. The default density of the sample is that of the paper's soil, 1659 kg/m^3.
        `StoreError` if velocities depend on the pulse: then they give no modulus; `QueryError` for a density of no
        soil.

        Examples
        --------
        >>> moduli = open_campaign("quick.db").small_strain_modulus()
        >>> 1e9 < float(moduli.sel(content=5.0).mean()) < 1e10, moduli.attrs["units"]
        (True, 'Pa')
        """
        if density is not None and not 100.0 <= density <= 2e4:  # kg/m^3, from foam to metal
            raise QueryError(f"density = {density:g} kg/m^3: is none of a soil.", "Give one such as 1659.")
        found = self.to_xarray(("effective_vs", "pulse_effect"))
        effect = found["pulse_effect"].max("seed")
        loud = effect[depends_on_pulse(effect.to_numpy())]
        if loud.size:
            contents = ", ".join(f"{content:g}" for content in loud["content"].to_numpy())
            raise StoreError(
                f"Velocities depend on the pulse, by up to {float(loud.max()):.1%}, at {contents} %.",
                "Compute with a smaller wave.amplitude: a modulus of small strain needs a quiet pulse.",
            )
        moduli = small_strain_modulus(found["effective_vs"], density).rename("small_strain_modulus")
        return moduli.assign_attrs(units="Pa", long_name="small-strain shear modulus")

    @property
    def damping_ratio(self) -> float:
        """Damping ratio D = alpha / pi of the samples."""
        return damping_ratio(self.config["wave"]["damping"])

    def static_speed(self, *, seed: int, content: float) -> "StaticSpeed":
        """Compute the speed of long shear waves of a sample, m/s, from the stiffness of its inner part, and its error.

        `UnknownCellError` if the cell has no outcome, or its cement is unknown.

        Examples
        --------
        >>> campaign = open_campaign("quick.db")
        >>> static = campaign.static_speed(seed=1, content=5.0)
        >>> 0.8 < campaign.cell(seed=1, content=5.0).effective_vs / static.speed < 1.2
        True
        """
        from calcidem.dem.wave.static_speed import static_speed  # noqa: PLC0415 - loads the engine

        return static_speed(*self.cemented(seed=seed, content=content))

    def dispersion(self, *, content: float) -> Dispersion:
        """Compute phase velocity against frequency from the sections of a content.

        `UnknownCellError` if no cell has a velocity and a stored section.
        """
        try:
            return dispersion_of_cells(self.select(content=content, status="done", with_arrays=True))
        except ValueError as error:
            raise UnknownCellError(f"Content {content:g} %: {error}.", "Compute with run.store_sections.") from error

    def cemented(self, *, seed: int, content: float) -> tuple[Experiment, Flags]:
        """Return the experiment of a cell, and flags (C,) of its cemented pairs; errors as for `sample`."""
        index, cement = self._cement(seed, content)
        experiment = self.experiment(index)
        return experiment, _contact_kinds(experiment.packing, cement) != CementKind.NONE

    def predict(
        self, *, content: float, seed: int | None = None, pattern: CementPattern | None = None, level: float = 0.95
    ) -> Prediction:
        """Predict Vs of a sample, and an interval, from the campaign's samples of that content (%).

        Nothing is simulated. Give a seed, whose cement is drawn and which takes no part in the fit, or a cement
        pattern; without both the prediction uses the content alone. The feature of the cement is its conductance, see
        `packing_graph.NETWORK_FEATURES`. `QueryError` if the campaign has too few velocities at the content, or if
        the pattern does not match it.

        Examples
        --------
        >>> prediction = open_campaign("quick.db").predict(content=5.0, seed=501)
        >>> 500.0 < prediction.interval.low < prediction.vs < prediction.interval.high < 3000.0
        True
        """
        if pattern is None and seed is not None:
            experiment = self.experiment()
            try:
                pattern = pattern_of(experiment.packing, experiment.ordering(seed).at(content))
            except CementCapacityError as error:
                raise QueryError(f"seed = {seed}: {error}.", "Choose a lower content.") from error
        return predict_velocity(self.analyse(), content, pattern, level, without_seed=seed)

    def graph(self, *, seed: int, content: float) -> "nx.Graph[int]":
        """Return the contact graph of a sample as a `networkx.Graph`; errors as for `sample`.

        Every grain is a vertex with `role` (transmitter, receiver or interior), every contact an edge with `bonded` and
        `weight` by its physical meaning (Eq. 8 of the paper).

        Examples
        --------
        >>> campaign = open_campaign("quick.db")
        >>> graph = campaign.graph(seed=1, content=5.0)
        >>> graph.number_of_edges() == len(campaign.sample(seed=1, content=5.0).packing.pairs)
        True
        """
        index, cement = self._cement(seed, content)
        packed = self._graphs[index]
        return packed.graph.to_networkx(packed.kinds(cement) > 0, packed.weights)

    def sample(self, *, seed: int, content: float) -> Sample:
        """Rebuild a sample before the pulse: the same disks, forces and cement, to the last bit.

        `UnknownCellError` if the cell has no outcome, or its cement is unknown; `StoreError` if configuration or
        packing are incomplete, since the database was not made by a run.

        Examples
        --------
        >>> import calcidem.dem
        >>> sample = open_campaign("quick.db").sample(seed=1, content=5.0)
        >>> state = calcidem.dem.start(sample.scene, preload=sample.packing.preload)
        >>> calcidem.dem.advance(state, 10).steps
        10
        """
        index, cement = self._cement(seed, content)
        experiment = self.experiment(index)
        packing, sand = experiment.stiffen()
        kind = _contact_kinds(packing, cement)
        cemented = packing.pairs[kind != CementKind.NONE]
        bonds = Bonds(cemented, experiment.cement, installation=experiment.installation) if len(cemented) else None
        return Sample(seed, content, packing, kind, wave_scene(packing, sand, experiment.wave, bonds))

    def experiment(self, packing_index: int = 0) -> Experiment:
        """Return the experiment of the cells of a packing, for `dem.wave.measurement`; errors as for `sample`."""
        return stored_experiment(self.store, packing_index)

    def content_hash(self, packing_index: int = 0) -> str:
        """Return the content hash of a packing.

        All cells with this packing were computed on the same bits of disks and forces.
        """
        return self.packing(packing_index).content_hash

    @cached_property
    def plot(self) -> "CampaignPlots":
        """Figures of the campaign; ``dir(campaign.plot)`` lists them.

        Examples
        --------
        >>> campaign = open_campaign("quick.db")
        >>> campaign.plot.vs_range().axes[0].get_xlabel()
        'calcite content (% of sand mass)'
        """
        from calcidem.app.campaign.plots import CampaignPlots  # noqa: PLC0415 - matplotlib takes half a second

        return CampaignPlots(self.analyse(), self.cemented)

    def analyse(
        self, most_samples: int | None = None, features: Mapping[str, Feature] | None = None
    ) -> CampaignAnalysis:
        """Return the analysis of the campaign in its present state; each part is computed at its first use.

        With more cells than ``most_samples``, paths are analysed only for the samples of the first seeds. ``features``
        are functions of your own by name, beside those of installed packages; `own_table` has their values.
        """
        return CampaignAnalysis(self.store, most_samples, with_patterns, installed_features() | dict(features or {}))

    @cached_property
    def _graphs(self) -> tuple[PackingGraph, ...]:
        return self.analyse().graphs

    def _cement(self, seed: int, content: float) -> tuple[int, CementPattern]:
        """Return the index of a cell's packing, and its cement."""
        cell = self.cell(seed=seed, content=content)
        if cell.cement is None:
            raise UnknownCellError(
                f"The cement of seed {seed} and content {content} % is not stored, and cannot be drawn again.",
                "Only cells that were computed, with this version of the physics, have one.",
            )
        return cell.packing_index, cell.cement


def _contact_kinds(packing: Packing, cement: CementPattern) -> npt.NDArray[np.uint8]:
    """Return the cement of each of ``packing.pairs``, (C,), see `calcidem.dem.sample.cement.CementKind`.

    `ValueError` if the pattern cements two disks that do not touch.
    """
    from calcidem.dem.engine.assembly import pair_keys  # noqa: PLC0415 - loads the engine, which reading needs not

    count = len(packing.radius)
    contacts, cemented = (pair_keys(pairs, count) for pairs in (packing.pairs, cement.contacts))
    kinds = dict(zip(cemented.tolist(), cement.kind.tolist(), strict=True))
    if strange := kinds.keys() - set(contacts.tolist()):
        first, second = divmod(min(strange), count)
        raise ValueError(f"disks {first} and {second} are cemented but do not touch: not the packing of this cell")
    return np.array([kinds.get(key, CementKind.NONE) for key in contacts.tolist()], dtype=np.uint8)


def _write_vtu(sample: Sample, file: Path) -> None:
    """Write disks as points and contacts as lines.

    The points have `radius` (m); show them with the filter Glyph, scaled by it. The lines have `kind` (0 sand, 1 P, 2
    C); vertices have the kind -1, so that a threshold separates them from the contacts.
    """
    try:
        import meshio  # type: ignore[import-untyped]  # noqa: PLC0415 - an optional library, without types
    except ModuleNotFoundError as error:
        raise StoreError(
            "Files for ParaView need the library meshio.", "Install it: pip install 'calcidem[paraview]'."
        ) from error
    packing = sample.packing
    count = len(packing.radius)
    cells = [("vertex", np.arange(count)[:, None]), ("line", packing.pairs.astype(np.int64))]
    mesh = meshio.Mesh(
        np.column_stack([packing.x, packing.y, np.zeros(count)]),
        cells,
        point_data={"radius": packing.radius},
        cell_data={"kind": [np.full(count, -1, dtype=np.int32), sample.kind.astype(np.int32)]},
    )
    mesh.write(file, file_format="vtu")


def load_paper_campaign(preset: Literal["paper", "paper-as-printed"] = "paper") -> xr.Dataset:
    """Return the quantities of the 1,972 samples of the paper's campaign, as computed by calcidem.

    Along (seed, content): Vs by three methods (m/s), errors, path features, time step and others, each with unit and
    meaning. Samples without a velocity have NaN. Sections and cement patterns are left out. The attribute
    ``calcidem_config`` has the configuration, ``calcidem_runs`` versions and machine.

    Parameters
    ----------
    preset
        ``"paper"`` has a quiet pulse; under the printed one of ``"paper-as-printed"`` Vs depends on the pulse.

    Examples
    --------
    >>> import calcidem
    >>> campaign = calcidem.load_paper_campaign()
    >>> dict(campaign.sizes), int(campaign.vs.notnull().sum())
    ({'seed': 116, 'content': 17}, 1965)
    >>> round(float(campaign.vs.sel(content=0.66).mean()), -1)
    370.0
    """
    if preset not in (known := ("paper", "paper-as-printed")):
        raise QueryError(f"There are no results of '{preset}'.", f"Give one of {', '.join(known)}.")
    with (
        as_file(files("calcidem.app.config.presets").joinpath(f"{preset}.nc")) as path,
        xr.open_dataset(path) as dataset,
    ):
        return dataset.load()


def predict_velocity(
    analysis: CampaignAnalysis,
    content: float,
    pattern: CementPattern | None = None,
    level: float = 0.95,
    without_seed: int | None = None,
) -> Prediction:
    """Predict Vs of a sample of a content (%) of a campaign, with an interval.

    With the sample's cement the prediction uses its conductance (`packing_graph.NETWORK_FEATURES`), of which Vs is
    about a power, without it the content alone. The seed to predict takes no part in the fit. The one sample without
    cement has the interval of its velocity. `QueryError` if the cement is not that of a sample of this content, or the
    campaign has too few velocities there.
    """
    if not 0.0 < level < 1.0:
        raise QueryError(f"level = {level}: is not a probability.", "Give one between 0 and 1, such as 0.95.")
    contents = analysis.vs["content"].to_numpy()
    if not np.isclose(contents, content).any():
        known = ", ".join(f"{known:g}" for known in contents)
        raise QueryError(f"content = {content:g} %: the campaign has no such cells.", f"Choose among {known} %.")
    nearest = float(contents[np.argmin(np.abs(contents - content))])
    table, vs, seeds = _samples_at(analysis, nearest, with_cement=pattern is not None)
    if nearest == 0.0 and vs.size:  # without cement all seeds are the same sample
        error = float(analysis.cells["vs_error"].sel(content=nearest, seed=seeds[0]))
        return Prediction(float(vs[0]), Interval.of_velocity(float(vs[0]), error, level), uses_features=False)
    others = np.ones(len(vs), dtype=bool) if without_seed is None else seeds != without_seed
    fewest = FEWEST_ROWS + 1 + table.shape[1]  # one more than a fit needs, for checking
    if others.sum() < fewest:
        problem = f"At {content:g} % {pluralize(int(others.sum()), 'cell')} with a velocity can be used."
        raise QueryError(problem, f"Compute at least {fewest} seeds.")
    features: Floats = np.empty(0)
    if pattern is not None and table.shape[1]:
        graph = analysis.graphs[0]
        try:
            found = graph.network_features(graph.kinds(pattern) > 0).network_conductance or math.nan
        except ValueError as error:
            raise QueryError(f"{error}.", "Give the contacts of a sample of this campaign.") from error
        features, known = np.array([math.log(found)]), table[others, 0]
        low, high = float(known.min()), float(known.max())
        if high > low and not 2.0 * low - high <= features[0] <= 2.0 * high - low:  # further away than their range
            least, most = math.exp(low), math.exp(high)
            raise QueryError(
                f"network_conductance = {found:.3g} is far from the {least:.3g} to {most:.3g} of the samples at "
                f"{content:g} %.",
                "Give cement that a sample of this content has.",
            )
    return VelocityPredictor.fit(table[others], vs[others], level).predict(features)


def check_predictions(
    analysis: CampaignAnalysis, level: float = 0.95, *, with_cement: bool = True
) -> dict[float, tuple[Flags, Floats]]:
    """Predict every sample from the other seeds of its content: see `check_samples`, by content.

    Contents with few velocities or without scatter are left out; without cement all seeds are the same sample.
    """
    checks: dict[float, tuple[Flags, Floats]] = {}
    for content in analysis.vs["content"].to_numpy().tolist():
        features, vs, _ = _samples_at(analysis, content, with_cement=with_cement)
        if len(vs) > FEWEST_ROWS + features.shape[1] and np.ptp(vs) > 0.0:
            checks[content] = check_samples(features, vs, level)
    return checks


def _samples_at(analysis: CampaignAnalysis, content: float, *, with_cement: bool) -> tuple[Floats, Floats, Integers]:
    """Samples of a content with a velocity: logarithms of the conductance (n, 1) or (n, 0), Vs in m/s and seeds (n,).

    Those without a conductance are left out, unless none has one.
    """
    vs = analysis.vs.sel(content=content).to_numpy().astype(float)
    conductance = analysis.cells["network_conductance"].sel(content=content).to_numpy().astype(float)
    known = np.isfinite(vs) & (conductance > 0.0)
    chosen = known if with_cement and known.any() else np.isfinite(vs)
    features = np.log(conductance[chosen])[:, None] if chosen is known else np.empty((int(chosen.sum()), 0))
    return features, vs[chosen], analysis.vs["seed"].to_numpy()[chosen]
