"""Products of the analysis of a stored campaign, each computed at first use."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import compress
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from calcidem.analysis.correlation import PathEnvelope, RatioScan, path_envelope, scan_ratio
from calcidem.analysis.distribution import ContentDistribution, describe_contents, name_outcomes
from calcidem.analysis.fits import LeaveOneSeedOut, PowerLawFit, fit_power_law, leave_one_seed_out
from calcidem.analysis.measured import PublishedLaw, PublishedVelocity, Target, published_study
from calcidem.analysis.packing_graph import (
    FEATURES,
    NETWORK_FEATURES,
    ContactWeights,
    Feature,
    PackingGraph,
    PreferentialPath,
    describe_feature,
    normalized_connectivity,
    packing_graph,
)
from calcidem.analysis.velocity import (
    ContentDispersion,
    Dispersion,
    ErrorBudget,
    are_samples,
    dispersion,
    error_budget,
    median_known,
)
from calcidem.ends import CellStatus
from calcidem.storage.dataset import campaign_dataset
from calcidem.storage.records import CellResult, CementPattern, NetworkFeatures, PathFeatures, Selection
from calcidem.storage.sql.store import Store


class UnavailableError(Exception):
    """Product that is not available at present; the message names the missing data."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSample:
    """A computed cell with its cement and its path."""

    seed: int
    content: float
    """Identity; content in percent."""
    vs: float
    """Shear-wave velocity in m/s; NaN if missing."""
    packing_index: int
    kinds: NDArray[np.uint8]
    """0 (sand), 1 (P) or 2 (C) for each contact of that packing's graph, shape (m,)."""
    path: PreferentialPath
    features: PathFeatures
    network: NetworkFeatures
    """Its preferential path, the features of this path, and those of its cement as a network."""


@dataclass(frozen=True, slots=True, eq=False)
class LawFit:
    """The law Vs = a C^b + c for one measure C of the cement."""

    name: str
    """Choice of the weights, named as in the published tables, or the measure."""
    weights: ContactWeights | None
    connectivity: NDArray[np.float64]
    """C of each sample of `CampaignAnalysis.samples`, shape (n,): C_d,n for the weights, or the conductance G."""
    fit: PowerLawFit
    check: LeaveOneSeedOut
    """The fit, and its errors for seeds left out."""


@dataclass(frozen=True, eq=False)
class CampaignAnalysis:
    """The analysis of a campaign, lazy and cached.

    Attributes raise `UnavailableError` if the campaign lacks their data. Cells are read when an
    attribute is first used, so the analysis of a running campaign is a snapshot.
    """

    store: Store
    """Store with a selected campaign."""
    most_samples: int | None = None
    """Above this number of cells, paths are analysed only for the samples of the first seeds."""
    with_cement: Callable[[Store, Iterable[CellResult]], Iterator[CellResult]] = lambda _, outcomes: iter(outcomes)
    """Adds cement that is not stored to outcomes of the store, if possible."""
    features: Mapping[str, Feature] = field(default_factory=dict)
    """Features of other packages, or of the calling program, by name."""
    measured: tuple[Target, ...] = ()
    """Laboratory velocities for comparison."""

    @cached_property
    def config(self) -> dict[str, Any]:
        """The physical configuration."""
        return self.store.record.parameters

    @cached_property
    def cells(self) -> xr.Dataset:
        """All scalar quantities along (seed, content)."""
        return campaign_dataset(self.store)

    @cached_property
    def distinct(self) -> xr.Dataset:
        """The same of distinct samples with a velocity alone, NaN elsewhere: the population of tables and medians.

        Samples with an effective velocity, of which Vs may be unknown, are that of this velocity and its error.
        """
        numbers = self.cells[[name for name, values in self.cells.items() if values.dtype.kind in "if"]]
        with_vs, with_effective = (
            xr.DataArray(are_samples(self.cells[name], self.cells["content"]), self.vs.coords)
            for name in ("vs", "effective_vs")
        )
        effective = numbers[["effective_vs", "effective_error"]].where(with_effective)
        return numbers.where(with_vs).assign(effective.data_vars)

    @cached_property
    def vs(self) -> xr.DataArray:
        """Shear-wave velocity in m/s along (seed, content), NaN if missing."""
        return self.cells["vs"]

    @cached_property
    def status(self) -> xr.DataArray:
        """Outcome of each cell as text along (seed, content), empty if not computed."""
        return name_outcomes(self.cells["status"])

    @cached_property
    def distributions(self) -> tuple[ContentDistribution, ...]:
        """Distribution of Vs at each content."""
        return describe_contents(self.cells)

    @cached_property
    def budget(self) -> ErrorBudget:
        """Errors of all velocities."""
        return error_budget(self.cells)

    @cached_property
    def graphs(self) -> tuple[PackingGraph, ...]:
        """Contact graph of each packing of the campaign, by its index."""
        wave = self.config.get("wave", {})
        names = ("transmitter_half_width", "receiver_half_width", "boundary_thickness")
        missing = [name for name in names if name not in wave]
        if missing:
            raise UnavailableError(f"the configuration of the campaign lacks wave.{missing[0]}")
        indices = self.store.packing_indices()
        if list(indices) != list(range(len(indices))) or not indices:
            raise UnavailableError(f"packings {list(indices)} are stored; all from 0 on are needed")
        packings, layers = map(self.store.packing, indices), [float(wave[name]) for name in names]
        with _translate_refusals():
            return tuple(packing_graph(packing, *layers) for packing in packings)

    @cached_property
    def analysed_seeds(self) -> tuple[int, ...]:
        """Seeds whose paths are analysed."""
        seeds = tuple(self.vs["seed"].to_numpy().tolist())
        if self.most_samples is None or self.vs.size <= self.most_samples:
            return seeds
        return seeds[: max(1, self.most_samples // self.vs.sizes["content"])]

    @cached_property
    def samples(self) -> tuple[MeasuredSample, ...]:
        """Distinct computed samples of these seeds with a stored cement pattern, by seed, then content.

        Without cement all seeds are one sample, so only the first of them is here.
        """
        found: dict[tuple[int | None, float], MeasuredSample] = {}
        with _translate_refusals():
            stored = self.store.results(Selection(self.analysed_seeds), with_arrays=("path", "cement"))
            for cell in self.with_cement(self.store, stored):
                key = cell.key.seed if cell.key.content else None, cell.key.content
                if cell.cement is not None and key not in found:
                    found[key] = self._sample(cell, cell.cement)
        if not found:
            raise UnavailableError("no cement pattern is stored, so the contacts of the samples are unknown")
        return tuple(found.values())

    @cached_property
    def table(self) -> xr.Dataset:
        """The eight features and Vs along (seed, content), NaN where missing."""
        return self._feature_table(FEATURES, lambda sample, name: getattr(sample.features, name))

    @cached_property
    def own_table(self) -> xr.Dataset:
        """The same with `features`."""
        if not self.features:
            raise UnavailableError("no package or program gave features of its own")
        definitions = {name: (name, describe_feature(feature)) for name, feature in self.features.items()}
        return self._feature_table(
            definitions,
            lambda sample, name: self.features[name](self.graphs[sample.packing_index], sample.kinds),
        )

    @cached_property
    def network_table(self) -> xr.Dataset:
        """Features of the cement as a network, and Vs along (seed, content), NaN where missing."""
        return self._feature_table(NETWORK_FEATURES, lambda sample, name: getattr(sample.network, name))

    @cached_property
    def envelopes(self) -> tuple[PathEnvelope, ...]:
        """Length of the shortest path for all weight ratios, for each sample."""
        with _translate_refusals():
            return tuple(
                path_envelope(self.graphs[sample.packing_index].graph, sample.kinds > 0) for sample in self.samples
            )

    @cached_property
    def ratio_scan(self) -> RatioScan:
        """Correlation of C_d,n with Vs over the weight ratio, and the best ratio."""
        with _translate_refusals():
            return scan_ratio(self.envelopes, self.sample_vs, self.sample_seeds)

    @cached_property
    def physical_law(self) -> LawFit:
        """The law with weights by their physical meaning (Eq. 8)."""
        connectivity = np.array([sample.features.path_normalized_connectivity for sample in self.samples])
        return self._law("physical meaning", self.graphs[0].weights, connectivity)

    @cached_property
    def compared_laws(self) -> tuple[list[LawFit], tuple[PublishedLaw, ...]]:
        """Laws with C_d,n, and the published ones for a campaign with the published sand and contents.

        Of the former the last is that of the scan; a published law whose weights no other has is fitted before it.
        """
        published = published_study().laws if published_velocities(self) else ()
        laws = [self.physical_law, self.law_of_ratio(self.ratio_scan.best_ratio, "Monte-Carlo")]
        # Only with equal weights is C_d,n comparable.
        others = [other for other in published if all(ratios_differ(law, other) for law in laws)]
        laws[1:1] = [self.law_of_ratio(other.weights.ratio, "the paper") for other in others]
        return laws, published

    @cached_property
    def conductance_law(self) -> LawFit:
        """The law with the conductance of the network instead of C_d,n."""
        found = [sample.network.network_conductance for sample in self.samples]
        return self._law("conductance", None, np.array(found, dtype=np.float64))

    def law_of_ratio(self, ratio: float, name: str) -> LawFit:
        """Return the law for a weight ratio, with the shortest paths at this ratio."""
        weights = ContactWeights.from_ratio(ratio)
        connectivity = np.array(
            [
                normalized_connectivity(
                    float(envelope.connectivity(weights.bond)), weights, self.graphs[sample.packing_index].straight
                )
                for sample, envelope in zip(self.samples, self.envelopes, strict=True)
            ]
        )
        return self._law(name, weights, connectivity)

    @property
    def sample_vs(self) -> NDArray[np.float64]:
        """Velocity of each of the samples in m/s, shape (n,)."""
        return np.array([sample.vs for sample in self.samples])

    @property
    def sample_seeds(self) -> NDArray[np.int64]:
        """Seed of each of the samples, shape (n,)."""
        return np.array([sample.seed for sample in self.samples])

    def cell(self, seed: int, content: float) -> CellResult:
        """Return the outcome of one cell; `UnknownCellError` if there is none."""
        return next(self.with_cement(self.store, [self.store.cell(seed=seed, content=content)]))

    def sample(self, seed: int, content: float) -> MeasuredSample:
        """Return one sample without reading the others.

        `UnavailableError` if its cement pattern is not stored, `UnknownCellError` if the cell has no outcome.
        """
        cell = self.cell(seed, content)
        if cell.cement is None:
            raise UnavailableError(f"no cement pattern of seed {seed} at {content:g} % is stored")
        with _translate_refusals():
            return self._sample(cell, cell.cement)

    @cached_property
    def dispersions(self) -> tuple[ContentDispersion, ...]:
        """Dispersion of each content with a velocity and a stored section in a cell."""
        found = []
        for row in self.distributions:
            column = self.distinct.sel(content=row.content)
            with suppress(ValueError):  # no section
                done = Selection(contents=row.content, statuses=CellStatus.DONE)
                spectrum = dispersion_of_cells(self.store.results(done, with_arrays=("section",)))
                medians = (median_known(column[name]) for name in ("vs", "static_speed"))
                found.append(ContentDispersion(row.content, spectrum, *medians))
        if not found:
            raise UnavailableError("no cell has a velocity and a stored section")
        return tuple(found)

    def measured_samples(self, content: float) -> list[MeasuredSample]:
        """Return the samples of one content that have a velocity, from the slowest to the fastest."""
        found = [s for s in self.samples if math.isclose(s.content, content) and math.isfinite(s.vs)]
        return sorted(found, key=lambda sample: sample.vs)

    def _feature_table(
        self,
        definitions: Mapping[str, tuple[str, str]],
        value: Callable[[MeasuredSample, str], float],
    ) -> xr.Dataset:
        """Features of each of `samples` by their names, and Vs, along (seed, content); NaN where missing."""
        table = xr.Dataset(coords={"seed": self.vs["seed"], "content": self.vs["content"]})
        rows = np.searchsorted(table["seed"], [sample.seed for sample in self.samples])
        columns = np.searchsorted(table["content"], [sample.content for sample in self.samples])
        for name, (_, definition) in definitions.items():
            values = np.full(self.vs.shape, math.nan)
            values[rows, columns] = [value(sample, name) for sample in self.samples]
            table[name] = ("seed", "content"), values
            table[name].attrs = {"units": "1", "long_name": definition}
        table["vs"] = self.vs
        return table

    def _law(self, name: str, weights: ContactWeights | None, connectivity: NDArray[np.float64]) -> LawFit:
        with _translate_refusals():
            return LawFit(
                name=name,
                weights=weights,
                connectivity=connectivity,
                fit=fit_power_law(connectivity, self.sample_vs, self.sample_seeds),
                check=leave_one_seed_out(connectivity, self.sample_vs, self.sample_seeds),
            )

    def _sample(self, cell: CellResult, cement: CementPattern) -> MeasuredSample:
        graph = self.graphs[cell.packing_index]
        kinds = graph.kinds(cement)
        path = graph.path(kinds > 0, tuple(cell.path.grains.tolist()) if cell.path else ())
        return MeasuredSample(
            seed=cell.key.seed,
            content=cell.key.content,
            vs=math.nan if cell.vs is None else cell.vs,
            packing_index=cell.packing_index,
            kinds=kinds,
            path=path,
            features=cell.features or graph.features(graph.shortest_paths(kinds > 0)),
            network=cell.network or graph.network_features(kinds > 0),
        )


def published_velocities(analysis: CampaignAnalysis) -> list[tuple[float, PublishedVelocity]]:
    """Return the published rows for a campaign with the published sand; empty if fewer than two contents match."""
    if not published_study().has_sand_of(analysis.config):
        return []
    contents = {round(content, 6) for content in analysis.vs["content"].to_numpy().tolist()}  # as tables look them up
    rows = [row for row in published_study().velocities if round(row[0], 6) in contents]
    return rows if len(rows) > 1 else []


def ratios_differ(law: LawFit, other: PublishedLaw) -> bool:
    """Whether a law has other weights than a published one, beyond the rounding of these."""
    return law.weights is None or abs(other.weights.ratio - law.weights.ratio) >= 0.02


def dispersion_of_cells(cells: Iterable[CellResult]) -> Dispersion:
    """Return the dispersion from the stored sections of cells of one content that have a velocity.

    Phase velocities are searched from a third to three times the median Vs. Without cement all cells are one sample.
    `ValueError` if no cell has a velocity and a section.
    """
    found = [
        (math.nan if cell.vs is None else cell.vs, cell.section, cell.key.content)
        for cell in cells
        if cell.section is not None
    ]
    counted = are_samples([vs for vs, *_ in found], [content for *_, content in found])
    read = [(vs, section) for vs, section, _ in compress(found, counted)]
    if not read:
        raise ValueError("no cell has a velocity and a stored section, which a dispersion needs")
    median = float(np.median([vs for vs, _ in read]))
    motions = [(found.time, found.places, found.across.astype(float)) for _, found in read]
    return dispersion(motions, read[0][1].pulse_frequency, (median / 3.0, 3.0 * median))


@contextmanager
def _translate_refusals() -> Iterator[None]:
    """Convert a `ValueError` of the analysis into an `UnavailableError` with the same message."""
    try:
        yield
    except ValueError as error:
        raise UnavailableError(str(error)) from error
