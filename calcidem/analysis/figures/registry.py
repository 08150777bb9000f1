"""All figures of campaigns and of studies: file name, title, caption, and function that draws it."""

from contextlib import suppress

import xarray as xr
from matplotlib.figure import Figure

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError, published_velocities
from calcidem.analysis.correlation import correlate
from calcidem.analysis.distribution import ContentDistribution
from calcidem.analysis.figures.samples import (
    Arrival,
    draw_cemented_samples,
    draw_dispersion,
    draw_measurement,
    draw_preferential_paths,
    draw_signals,
    load_arrival,
)
from calcidem.analysis.figures.style import FigureEntry, pick_evenly
from calcidem.analysis.figures.velocities import (
    draw_conductance,
    draw_correlations,
    draw_damping_study,
    draw_frequency_study,
    draw_histograms,
    draw_laws,
    draw_methods,
    draw_narrowing,
    draw_range,
    draw_ratio_scan,
    draw_reading_study,
    rows_with_velocity,
)


def _varied_contents(analysis: CampaignAnalysis) -> list[float]:
    """Contents with at least three different velocities; `UnavailableError` without any."""
    rows = [row for row in analysis.distributions if row.vs.n >= 3]
    if found := [row.content for row in rows if row.vs.standard_deviation > 0]:
        return found
    raise UnavailableError("no content has 3 different velocities")


def _first_arrival_at(analysis: CampaignAnalysis, row: ContentDistribution) -> Arrival:
    """Signals of the first seed with a velocity at a content."""
    return load_arrival(analysis, int(analysis.vs.sel(content=row.content).dropna("seed")["seed"][0]), row.content)


def _plot_cemented_samples(analysis: CampaignAnalysis) -> Figure:
    cemented = [sample for sample in analysis.samples if sample.packing_index == 0 and sample.kinds.any()]
    if not cemented:
        raise UnavailableError("no cemented sample is stored")
    of_seed = [sample for sample in cemented if sample.seed == cemented[0].seed]
    # one sample with P contacts alone and two with clusters
    chosen = [sample for sample in of_seed if sample.kinds.max() == 1][-1:]
    if clustered := [sample for sample in of_seed if sample.kinds.max() > 1]:
        middle = min(clustered, key=lambda sample: abs(sample.content - 2.5))  # half the content of `paths`
        chosen += [sample for sample in clustered if sample in (middle, clustered[-1])]
    return draw_cemented_samples(analysis.graphs[0], chosen)


def _plot_measurement(analysis: CampaignAnalysis) -> Figure:
    arrival: Arrival | None = None
    with suppress(UnavailableError):  # then without signals
        rows = rows_with_velocity(analysis.distributions)
        arrival = _first_arrival_at(analysis, rows[len(rows) // 2])
    return draw_measurement(analysis.graphs[0], analysis.config.get("wave", {}), arrival)


def _plot_paths(analysis: CampaignAnalysis) -> Figure:
    content = min(_varied_contents(analysis), key=lambda content: abs(content - 5.0))  # as Fig. 12 of the paper
    ordered = [sample for sample in analysis.measured_samples(content) if sample.packing_index == 0]
    if len(ordered) < 3:
        raise UnavailableError("fewer than 3 samples have a stored cement pattern")
    return draw_preferential_paths(analysis.graphs[0], [ordered[0], ordered[len(ordered) // 2], ordered[-1]])


CAMPAIGN_FIGURES: tuple[FigureEntry[CampaignAnalysis], ...] = (
    FigureEntry(
        "vs_range",
        "Vs against calcite content",
        "The bands hold 95 % and 50 % of the samples; of fewer than 20 each is a dot with the 95 % interval of its "
        "velocity. The line joins the means, with their 95 % intervals for further seeds of the packing. Rings mark "
        "contents at which velocities depend on the pulse.",
        lambda analysis: draw_range(
            analysis.cells, analysis.distributions, published_velocities(analysis), analysis.measured
        ),
    ),
    FigureEntry(
        "histograms",
        "Distribution of Vs at each content",
        "Bars and ticks are the samples, the line is the normal distribution with their mean and standard "
        "deviation. S is skewness, K kurtosis and p the small-sample p-value of the Jarque-Bera test; numbers "
        "are coloured where it is below 0.05.",
        lambda analysis: draw_histograms(analysis.vs, analysis.distributions, analysis.measured),
    ),
    FigureEntry(
        "samples",
        "Cemented samples",
        "Samples of one seed from P contacts alone to clusters (C); below, the framed parts enlarged. A contact "
        "cemented at one content is cemented at every larger one.",
        _plot_cemented_samples,
        pictorial=True,
    ),
    FigureEntry(
        "measurement",
        "Measurement of Vs",
        "The transmitter, a band of the left wall or its grains, moves up for one pulse; the shear wave crosses the "
        "sample to the receiver, a band of the right wall. Grey layers are strongly damped and absorb reflections from "
        "floor and lid.",
        _plot_measurement,
        pictorial=True,
    ),
    FigureEntry(
        "signals",
        "Signals and their arrivals",
        "Transmitted (grey) and received (blue) signal, each over its peak, with the arrival by each method. Peak and "
        "cross-correlation count from the transmitted peak, the first arrival from the transmitted onset.",
        lambda analysis: draw_signals(
            [_first_arrival_at(analysis, row) for row in pick_evenly(rows_with_velocity(analysis.distributions), 5)]
        ),
    ),
    FigureEntry(
        "methods",
        "Three methods to read the arrival",
        "Median and central 80 % of the samples for each method to read the travel time.",
        lambda analysis: draw_methods(analysis.cells, analysis.measured),
    ),
    FigureEntry(
        "dispersion",
        "Phase velocity against frequency",
        "Power of the space-time sections of a content, stacked with the delays of plane waves and averaged over the "
        "samples: dark where all stations move in phase. Dots are its ridge with the standard error, where that is "
        "below 25 % and the power above 0.3. At 0 % there is one sample.",
        lambda analysis: draw_dispersion(analysis.dispersions),
    ),
    FigureEntry(
        "paths",
        "Slow, middle and fast sample of one content",
        "The slowest sample, the one in the middle and the fastest at one content, with the path of smallest "
        "weighted length from transmitter to receiver. Rings mark the contacts on it that are not cemented.",
        _plot_paths,
        pictorial=True,
    ),
    FigureEntry(
        "correlations",
        "Correlation of path features and Vs",
        "Within one content the mean is subtracted and the rest divided by the scatter there, so that contents count "
        "alike.",
        lambda analysis: draw_correlations(correlate(analysis.table)),
    ),
    FigureEntry(
        "weight_scan",
        "Weight of a cemented contact",
        "Correlation of C_d,n with Vs over the ratio of the two contact weights; the shortest path of every "
        "sample is searched for every ratio. The band holds the best ratio of 95 % of bootstrap replicates "
        "over seeds. On a plateau the shortest paths no longer change; its smallest ratio is "
        "taken as the best.",
        draw_ratio_scan,
    ),
    FigureEntry(
        "laws",
        "Vs against connectivity",
        "Fits of Vs = a C^b + c for each choice of weights, and at the mean connectivity of each content with 10 "
        "samples or more the interval in which 95 % of new samples fall.",
        draw_laws,
    ),
    FigureEntry(
        "network_correlations",
        "Correlation of features of the whole sample and Vs",
        "As for features of the path, for those of the cement as a network between the walls.",
        lambda analysis: draw_correlations(correlate(analysis.network_table)),
    ),
    FigureEntry(
        "conductance",
        "Vs against the conductance of the cement",
        "Cement as a network of conductors between the side walls, and one law fitted to the samples of all contents.",
        draw_conductance,
    ),
    FigureEntry(
        "narrowing",
        "Monte-Carlo error against number of seeds",
        "Half-width of the 95 % intervals of mean, standard deviation and skewness, forecast from the samples "
        "computed so far; the dotted line marks their number.",
        lambda analysis: draw_narrowing(analysis.vs, pick_evenly(_varied_contents(analysis), 4)),
    ),
)
"""In the order of the report."""

STUDY_FIGURES: tuple[FigureEntry[xr.Dataset], ...] = (
    FigureEntry(
        "study_reading",
        "Peak to peak against first arrival",
        "Vs of the same samples by two methods of reading, over excitation frequency. Thin lines are samples, bold "
        "ones their mean where every sample has a value. Marks are hollow where transmitter and receiver are less than "
        "a wavelength apart, so that near-field effects spoil the reading.",
        draw_reading_study,
        study="frequency",
    ),
    FigureEntry(
        "study_frequency",
        "Excitation frequency",
        "Frequency of the received pulse (one over twice its width at half height) and Vs over the frequency of "
        "the transmitted one: mean and range where every sample has a value. Dashed at the campaign's frequency.",
        draw_frequency_study,
        study="frequency",
    ),
    FigureEntry(
        "study_damping",
        "Local damping",
        "Signals received in one sample with several local damping factors, and the Vs read from their peaks "
        "(triangles) where one could be trusted.",
        draw_damping_study,
        study="damping",
    ),
)
