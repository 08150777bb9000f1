"""All figures of a campaign: file name, title, caption, and function that draws it."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from calcidem.analysis.campaign_analysis import CampaignAnalysis, MeasuredSample, UnavailableError
from calcidem.analysis.figures.dispersion import draw_dispersion
from calcidem.analysis.figures.relations import draw_correlations, draw_laws, draw_ratio_scan
from calcidem.analysis.figures.samples import draw_cemented_samples, draw_measurement, draw_preferential_paths
from calcidem.analysis.figures.signals import METHOD_STYLES, Arrival, draw_signals
from calcidem.analysis.figures.velocities import draw_histograms, draw_methods, draw_narrowing, draw_range
from calcidem.analysis.planning import narrowing
from calcidem.analysis.published import PublishedVelocity, published_study
from calcidem.storage.errors import UnknownCellError
from calcidem.storage.records import CellResult

_FIRST_ARRIVAL_LEVEL = 0.1
_SHOWN_SIGNALS = 5
_SHOWN_NARROWINGS = 4
_SHOWN_DISPERSIONS = 6
_SHOWN_HISTOGRAMS = 24
_SAMPLES_OF_A_CONTENT = 3
_PATHS_CONTENT = 5.0
"""Content at which preferential paths are compared; the nearest one of the campaign is used."""

_SEED_COUNTS = tuple(int(count) for count in np.unique(np.geomspace(4, 512, 15).round()))


@dataclass(frozen=True, slots=True)
class CampaignFigure:
    """Figure of a campaign."""

    name: str
    """File name without ending."""
    title: str
    """Title in a few words."""
    caption: str
    """Caption in sentences."""
    draw: Callable[[CampaignAnalysis], Figure]
    """Draws it; `UnavailableError` if the campaign lacks the data."""
    pictorial: bool = False
    """Whether it shows thousands of grains, which are better drawn as pixels than as vectors."""


def published_velocities(analysis: CampaignAnalysis) -> list[tuple[float, PublishedVelocity]]:
    """Return the published rows for a campaign with the published sand; empty if fewer than two contents match."""
    if not published_study().has_sand_of(analysis.config):
        return []
    contents = analysis.vs["content"].to_numpy()
    rows = [row for row in published_study().velocities if np.isclose(contents, row[0], atol=1e-6).any()]
    return rows if len(rows) > 1 else []


def load_arrival(analysis: CampaignAnalysis, seed: int, content: float) -> Arrival:
    """Return the signals of a sample and their arrivals; errors as for `read_arrival`."""
    try:
        return read_arrival(analysis, analysis.cell(seed, content))
    except UnknownCellError as error:
        raise UnavailableError(str(error)) from error


def read_arrival(analysis: CampaignAnalysis, cell: CellResult) -> Arrival:
    """Return the signals of a cell and their arrivals; `UnavailableError` if no section is stored."""
    section = cell.section
    if section is None:
        raise UnavailableError(f"no section is stored for seed {cell.key.seed} at {cell.key.content:g} %")
    velocities = {name: getattr(cell, f"vs_{name}") for name in METHOD_STYLES}
    return Arrival(
        seed=cell.key.seed,
        content=cell.key.content,
        time=section.time,
        transmitted=section.transmitted,
        received=section.received,
        # A cell whose path is the whole width has no distance.
        distance=cell.distance or analysis.store.packing(cell.packing_index).width,
        velocities={name: value for name, value in velocities.items() if value is not None},
        onset=_FIRST_ARRIVAL_LEVEL,
    )


def _pick_evenly(contents: list[float], count: int) -> list[float]:
    """Return `count` contents from the smallest to the largest, evenly spaced in their order."""
    places = np.unique(np.linspace(0, len(contents) - 1, count).round().astype(int))
    return [contents[place] for place in places]


def _measured_contents(analysis: CampaignAnalysis) -> list[float]:
    """Contents with a velocity; `UnavailableError` without any."""
    if found := [row.content for row in analysis.distributions if row.vs.n]:
        return found
    raise UnavailableError("no sample has a velocity")


def _varied_contents(analysis: CampaignAnalysis) -> list[float]:
    """Contents with different velocities; `UnavailableError` without any."""
    rows = [row for row in analysis.distributions if row.vs.n >= _SAMPLES_OF_A_CONTENT]
    if found := [row.content for row in rows if row.vs.standard_deviation > 0]:
        return found
    raise UnavailableError(f"no content has {_SAMPLES_OF_A_CONTENT} different velocities")


def _first_arrival_at(analysis: CampaignAnalysis, content: float) -> Arrival:
    """Signals of the first seed with a velocity at a content."""
    return load_arrival(analysis, int(analysis.vs.sel(content=content).dropna("seed")["seed"][0]), content)


def _plot_cemented_samples(analysis: CampaignAnalysis) -> Figure:
    cemented = [sample for sample in analysis.samples if sample.packing_index == 0 and sample.kinds.any()]
    if not cemented:
        raise UnavailableError("no cemented sample is stored")
    of_seed = [sample for sample in cemented if sample.seed == cemented[0].seed]
    # one sample with P contacts alone and two with clusters
    single = [sample for sample in of_seed if sample.kinds.max() == 1]
    clustered = [sample for sample in of_seed if sample.kinds.max() > 1]
    chosen: list[MeasuredSample] = single[-1:]
    if clustered:
        middle = min(clustered, key=lambda sample: abs(sample.content - _PATHS_CONTENT / 2))
        chosen += [sample for sample in clustered if sample in (middle, clustered[-1])]
    return draw_cemented_samples(analysis.graphs[0], chosen)


def _plot_measurement(analysis: CampaignAnalysis) -> Figure:
    wave = analysis.config.get("wave", {})
    arrival: Arrival | None = None
    with suppress(UnavailableError):  # then without signals
        contents = _measured_contents(analysis)
        arrival = _first_arrival_at(analysis, contents[len(contents) // 2])
    return draw_measurement(
        analysis.graphs[0],
        transmitter_half_width=float(wave["transmitter_half_width"]),
        receiver_half_width=float(wave["receiver_half_width"]),
        damped_layer=float(wave.get("boundary_thickness", 0.0)),
        arrival=arrival,
    )


def _plot_signals(analysis: CampaignAnalysis) -> Figure:
    shown = _pick_evenly(_measured_contents(analysis), _SHOWN_SIGNALS)
    return draw_signals([_first_arrival_at(analysis, content) for content in shown])


def _plot_range(analysis: CampaignAnalysis) -> Figure:
    _measured_contents(analysis)  # raises an error without any
    return draw_range(analysis.cells, analysis.distributions, published_velocities(analysis), analysis.measured)


def _plot_histograms(analysis: CampaignAnalysis) -> Figure:
    shown = _pick_evenly(_measured_contents(analysis), _SHOWN_HISTOGRAMS)
    rows = [row for row in analysis.distributions if row.content in shown]
    return draw_histograms(analysis.vs, rows, analysis.measured)


def _plot_methods(analysis: CampaignAnalysis) -> Figure:
    if not bool(np.isfinite(analysis.cells["vs_peak"]).any()):
        raise UnavailableError("no sample has a velocity from peak to peak")
    return draw_methods(analysis.cells, analysis.measured)


def _plot_dispersion(analysis: CampaignAnalysis) -> Figure:
    known = {one.content: one for one in analysis.dispersions}
    return draw_dispersion([known[content] for content in _pick_evenly(list(known), _SHOWN_DISPERSIONS)])


def _plot_paths(analysis: CampaignAnalysis) -> Figure:
    varied = _varied_contents(analysis)
    ordered = analysis.measured_samples(min(varied, key=lambda content: abs(content - _PATHS_CONTENT)))
    ordered = [sample for sample in ordered if sample.packing_index == 0]
    if len(ordered) < _SAMPLES_OF_A_CONTENT:
        raise UnavailableError(f"fewer than {_SAMPLES_OF_A_CONTENT} samples have a stored cement pattern")
    chosen = [ordered[0], ordered[len(ordered) // 2], ordered[-1]]
    return draw_preferential_paths(analysis.graphs[0], chosen)


def _plot_ratio_scan(analysis: CampaignAnalysis) -> Figure:
    published = next(law for law in published_study().laws if law.name == "Monte-Carlo")
    shown = published.weights.ratio if published_velocities(analysis) else None
    return draw_ratio_scan(analysis.ratio_scan, shown)


def _plot_laws(analysis: CampaignAnalysis) -> Figure:
    contents = np.array([sample.content for sample in analysis.samples])
    published = published_study().laws if published_velocities(analysis) else ()
    laws = (analysis.physical_law, analysis.scanned_law)
    return draw_laws(laws, analysis.sample_vs, contents, published)


def _plot_narrowing(analysis: CampaignAnalysis) -> Figure:
    contents = _pick_evenly(_varied_contents(analysis), _SHOWN_NARROWINGS)
    return draw_narrowing({c: narrowing(analysis.vs.sel(content=c).to_numpy(), _SEED_COUNTS) for c in contents})


CAMPAIGN_FIGURES = (
    CampaignFigure(
        "vs_range",
        "Vs against calcite content",
        "Dots are samples, bars the 95 % intervals of their velocities (reading and simulation). Rings mark samples "
        "whose vs and path_vs differ by more than their errors. The line joins the means. Dark band: 95 % confidence "
        "interval of the mean. Pale band: interval of 95 % of new samples if Vs is normal at each content.",
        _plot_range,
    ),
    CampaignFigure(
        "histograms",
        "Distribution of Vs at each content",
        "Bars and ticks are the samples, the line is the normal distribution with their mean and standard "
        "deviation. S is skewness, K kurtosis and p the small-sample p-value of the Jarque-Bera test; numbers "
        "are coloured where it is below 0.05.",
        _plot_histograms,
    ),
    CampaignFigure(
        "samples",
        "Cemented samples",
        "Samples of one seed from P contacts alone to clusters (C); below, the framed parts enlarged. A contact "
        "cemented at one content is cemented at every larger one.",
        _plot_cemented_samples,
        pictorial=True,
    ),
    CampaignFigure(
        "measurement",
        "Measurement of Vs",
        "The transmitter, a band of the left wall or its grains, moves up for one pulse; the shear wave crosses the "
        "sample to the receiver, a band of the right wall. Grey layers are strongly damped and absorb reflections from "
        "floor and lid.",
        _plot_measurement,
        pictorial=True,
    ),
    CampaignFigure(
        "signals",
        "Signals and their arrivals",
        "Transmitted (grey) and received (blue) signal, each over its peak, with the arrival by each method. Peak and "
        "cross-correlation count from the transmitted peak, the first arrival from the transmitted onset.",
        _plot_signals,
    ),
    CampaignFigure(
        "methods",
        "Three methods to read the arrival",
        "Median and central 80 % of the samples for each method to read the travel time.",
        _plot_methods,
    ),
    CampaignFigure(
        "dispersion",
        "Phase velocity against frequency",
        "Power of the space-time sections of a content, stacked with the delays of plane waves and averaged over the "
        "samples: dark where all stations move in phase. Dots are its ridge with the standard error over samples, the "
        "diamond is the limit of long waves.",
        _plot_dispersion,
    ),
    CampaignFigure(
        "paths",
        "Slow, middle and fast sample of one content",
        "The slowest sample, the one in the middle and the fastest at one content, with the path of smallest "
        "weighted length from transmitter to receiver. Rings mark the contacts on it that are not cemented.",
        _plot_paths,
        pictorial=True,
    ),
    CampaignFigure(
        "correlations",
        "Correlation of path features and Vs",
        "Over all contents every feature correlates with Vs, since both grow with content. Within one the mean is "
        "subtracted and the rest divided by the scatter there, so that contents count alike.",
        lambda analysis: draw_correlations(analysis.correlations),
    ),
    CampaignFigure(
        "weight_scan",
        "Weight of a cemented contact",
        "Correlation of C_d,n with Vs over the ratio of the two contact weights; the shortest path of every "
        "sample is searched for every ratio. The band holds the best ratio of 95 % of bootstrap replicates "
        "over seeds. On a plateau the shortest paths no longer change; its smallest ratio is "
        "taken as the best.",
        _plot_ratio_scan,
    ),
    CampaignFigure(
        "laws",
        "Vs against connectivity",
        "Fits of Vs = a C^b + c for weights from the coordination number (left) and from the scan (right), "
        "and at the mean connectivity of each content the interval in which 95 % of new samples fall.",
        _plot_laws,
    ),
    CampaignFigure(
        "narrowing",
        "Monte-Carlo error against number of seeds",
        "Half-width of the 95 % intervals of mean, standard deviation and skewness, forecast from the samples "
        "computed so far; the dotted line marks their number.",
        _plot_narrowing,
    ),
)
"""In the order of the report."""
