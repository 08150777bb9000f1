"""The figures, drawn from a small real campaign."""

import os
import struct
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from string import ascii_lowercase

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from campaign_cells import campaign_cells
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from places import TUTORIAL

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError, published_velocities
from calcidem.analysis.distribution import describe_contents
from calcidem.analysis.figures import style
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.analysis.figures.samples import (
    COLOURS,
    _draw_scale,
    draw_cemented_samples,
    draw_measurement,
    draw_preferential_paths,
    load_arrival,
)
from calcidem.analysis.figures.velocities import _law_text, _symbol, draw_histograms, draw_methods, draw_range
from calcidem.app.campaign.opened import open_campaign

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "entry",
    [entry if entry.name == "vs_range" else pytest.param(entry, marks=pytest.mark.full) for entry in CAMPAIGN_FIGURES],
    ids=lambda entry: entry.name,
)
def test_a_figure_is_written_in_every_format(
    entry: style.FigureEntry[CampaignAnalysis], analysis: CampaignAnalysis
) -> None:
    """It becomes PNG (150 dpi), SVG and PDF."""
    figure = entry.draw(analysis)
    png, svg, pdf = style.save(figure, Path.cwd(), entry.name)
    width, height = struct.unpack(">II", png.read_bytes()[16:24])
    assert np.allclose([width, height], figure.get_size_inches() * 150, atol=1)
    assert ET.parse(svg).getroot().tag.endswith("svg")  # noqa: S314 - written just above
    assert pdf.read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("entry", CAMPAIGN_FIGURES, ids=lambda entry: entry.name)
def test_every_figure_is_drawn(entry: style.FigureEntry[CampaignAnalysis], analysis: CampaignAnalysis) -> None:
    """Each figure has labelled scales, lettered panels and free curves."""
    figure = entry.draw(analysis)
    panels = [axes for axes in figure.axes if axes.axison and axes.get_label() != "<colorbar>"]
    pictures = [axes.get_title(loc="left").partition(" ")[0] for axes in panels]
    assert len(panels) == 1 or pictures == [f"({letter})" for letter in ascii_lowercase[: len(panels)]]
    assert len(figure.legends) + sum(axes.get_legend() is not None for axes in panels) <= max(
        1, entry.name == "laws" and 2
    )
    labels = {figure.get_supxlabel(), *(axes.get_xlabel() for axes in figure.axes)}
    scaled = [axes for axes in figure.axes if axes.axison and axes.get_xticks().size and not axes.images]
    assert not scaled or labels != {""}
    figure.draw_without_rendering()
    assert not hidden_curves(figure)


def hidden_curves(figure: Figure) -> list[str]:
    """Titles of panels where a legend, an inset or a text lies on a point of a curve."""
    found = []
    for axes in figure.axes:
        legend = axes.get_legend()
        boxes = [cover.get_window_extent() for cover in (*axes.child_axes, *axes.texts, legend) if cover]
        for line in axes.lines:
            points = axes.transData.transform(np.column_stack([line.get_xdata(), line.get_ydata()]).astype(float))
            seen = points[((points >= axes.bbox.min) & (points <= axes.bbox.max)).all(axis=1)]
            if len(seen) and any(box.count_contains(seen) for box in boxes):
                found.append(axes.get_title(loc="left"))
    return found


def test_a_reading_that_no_cell_has_is_left_out_of_the_comparison(analysis: CampaignAnalysis) -> None:
    """Where no arrival could be read by one of the methods, the other two are drawn."""
    cells = analysis.cells.assign(
        vs_first_arrival=np.nan * analysis.vs, vs_peak=analysis.vs, vs_cross_correlation=analysis.vs
    )
    upper, lower = draw_methods(cells).axes
    assert (len(upper.lines), len(lower.lines)) == (2, 2)


def test_same_data_give_the_same_bytes(analysis: CampaignAnalysis) -> None:
    """A figure drawn twice is the same file, so that a repository sees no change where there is none."""
    entry = next(entry for entry in CAMPAIGN_FIGURES if entry.name == "vs_range")
    first, second = (style.render(entry.draw(analysis), "svg") for _ in range(2))
    assert first == second


def test_style_leaves_the_callers_settings_alone(analysis: CampaignAnalysis) -> None:
    """Drawing changes no setting of matplotlib."""
    before = dict(mpl.rcParams)
    CAMPAIGN_FIGURES[0].draw(analysis)
    assert dict(mpl.rcParams) == before


def test_range_shows_the_means(analysis: CampaignAnalysis) -> None:
    """The line of the range figure runs through the means of the measured samples."""
    figure = draw_range(analysis.cells, analysis.distributions)
    line = next(line for line in figure.axes[0].lines if line.get_label() == "mean")
    means = analysis.vs.mean("seed").dropna("content")
    assert np.allclose(line.get_xdata(), means["content"])
    assert np.allclose(line.get_ydata(), means)


def test_the_legend_of_the_range_covers_no_band(analysis: CampaignAnalysis) -> None:
    """It stands below the axes, and these have no velocity below zero."""
    figure = draw_range(analysis.cells, analysis.distributions)
    figure.draw_without_rendering()
    assert figure.legends[0].get_window_extent().y1 < figure.axes[0].get_window_extent().y0
    assert figure.axes[0].get_ylim()[0] >= 0.0


@pytest.mark.parametrize("seeds", [4, 40])
def test_the_range_shows_bands_of_many_samples_and_dots_of_few(seeds: int) -> None:
    """Contents up to 0.66 % have a panel of their own, and the one sample without cement the interval of its error."""
    contents = np.array([0.0, 0.34, 0.66, 5.0])
    vs = 200.0 + 200.0 * contents + np.arange(seeds)[:, None] * contents
    names = {"vs": vs, "vs_error": np.full_like(vs, 0.1), "pulse_effect": np.zeros_like(vs)}
    coords = {"seed": np.arange(seeds), "content": contents}
    cells = xr.Dataset({name: (("seed", "content"), values) for name, values in names.items()}, coords)
    rows = describe_contents(campaign_cells(cells["vs"], error=cells["vs_error"]))
    assert (rows[0].vs.n, rows[1].vs.n) == (1, seeds)
    assert rows[0].vs.mean_interval.half_width == pytest.approx(0.196 * 200.0, rel=1e-3)
    figure = draw_range(cells, rows)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["(a) up to 0.66 %", "(b) from 0.66 %"]
    told = [text.get_text() for text in figure.legends[0].get_texts()]
    assert ("50 % of the samples" in told) == (seeds == 40)
    assert ("sample and its 95 % interval" in told) == (seeds == 4)


def test_a_measurement_without_signals_is_one_panel(analysis: CampaignAnalysis) -> None:
    """Nothing is left blank beside the sample."""
    assert len(draw_measurement(analysis.graphs[0], analysis.config["wave"], None).axes) == 1


def test_histograms_are_densities(analysis: CampaignAnalysis) -> None:
    """The bars of each histogram have the area one, so that the normal density fits on them."""
    rows = [row for row in analysis.distributions if row.vs.standard_deviation > 0]
    panels = draw_histograms(analysis.vs, rows).axes[: len(rows)]
    for axes in panels:
        bars = [patch for patch in axes.patches if hasattr(patch, "get_height")]
        assert np.isclose(sum(bar.get_height() * bar.get_width() for bar in bars), 1.0)


def test_paths_are_drawn_through_their_grains(analysis: CampaignAnalysis) -> None:
    """The black line of a sample runs through the centres of its path's grains, in millimetres."""
    sample = analysis.measured_samples(2.55)[0]
    axes = draw_preferential_paths(analysis.graphs[0], [sample]).axes[0]
    line = next(line for line in axes.lines if line.get_color() == style.BLACK and len(line.get_xdata()) > 2)
    grains = list(sample.path.grains)
    assert np.allclose(line.get_xdata(), 1e3 * analysis.store.packing().x[grains])
    rings = next(line for line in axes.lines if line.get_marker() == "o")
    assert len(rings.get_xdata()) == sample.features.path_hertz_contacts


@pytest.mark.parametrize(("width", "length"), [(100.0, 20.0), (22.0, 5.0), (4.5, 1.0), (0.04, 0.01), (1500.0, 200.0)])
def test_a_scale_bar_has_a_round_length(width: float, length: float) -> None:
    """It is 1, 2 or 5 times a power of ten, and at most a quarter of the picture."""
    axes = Figure().subplots()
    _draw_scale(axes, 1.0, 2.0, width)
    assert np.ptp(axes.lines[0].get_xdata()) == pytest.approx(length)
    assert axes.texts[0].get_text() == f"{length:g} mm"


def test_fine_grains_are_drawn_as_coarse_ones(analysis: CampaignAnalysis) -> None:
    """The picture of a sample a hundred times as small is the same, but for the label of its scale bar."""
    graph, sample = analysis.graphs[0], analysis.measured_samples(2.55)[0]
    lengths = {name: 0.01 * getattr(graph.packing, name) for name in ("x", "y", "radius", "width", "height")}
    fine = replace(graph, packing=replace(graph.packing, **lengths))
    for draw in (draw_preferential_paths, draw_cemented_samples):
        for large, small in zip(draw(graph, [sample]).axes, draw(fine, [sample]).axes, strict=True):
            assert np.allclose(large.axis(), 100.0 * np.array(small.axis()))


def test_the_way_of_the_wave_is_the_distance_of_its_velocities(analysis: CampaignAnalysis) -> None:
    """Between the grains at both walls, which is less than the width of the box."""
    figure = next(entry for entry in CAMPAIGN_FIGURES if entry.name == "measurement").draw(analysis)
    (label,) = [text.get_text() for text in figure.axes[0].texts if text.get_text().startswith("L = ")]
    distance = float(analysis.cells["distance"].max())
    assert label == f"L = {1e3 * distance:.3g} mm"
    assert distance < analysis.store.packing().width
    arrows = [text for text in figure.axes[0].texts if isinstance(text, Annotation)]
    lengths = [abs(arrow.xy[0] - arrow.xyann[0]) for arrow in arrows if arrow.xy[1] == arrow.xyann[1]]
    assert lengths == [pytest.approx(1e3 * distance)]


def test_marked_peak_is_a_peak_of_the_signal(analysis: CampaignAnalysis) -> None:
    """The arrival from peak to peak lies on a maximum of the received signal, within the picking's smoothing."""
    arrival = load_arrival(analysis, 1, 0.34)
    index = int(np.searchsorted(arrival.time, arrival.arrival_time("peak")))
    period = 1.0 / float(analysis.cells["frequency"].sel(seed=1, content=0.34))
    reach = round(0.1 * period / (arrival.time[1] - arrival.time[0]))
    near = arrival.received[index - reach : index + reach + 1]
    assert 0 < int(np.argmax(near)) < len(near) - 1


def test_the_marked_first_arrival_begins_where_the_pulse_reaches_a_tenth(analysis: CampaignAnalysis) -> None:
    """``p(t) = (1 - cos 2 pi f t) / 2 = 0.1``; a line between two samples is off by ``step^2 p'' / (8 p')`` at most."""
    arrival = load_arrival(analysis, 1, 0.34)
    frequency = float(analysis.cells["frequency"].sel(seed=1, content=0.34))
    begun = arrival.arrival_time("first_arrival") - arrival.distance / arrival.velocities["first_arrival"]
    step = frequency * (arrival.time[1] - arrival.time[0])
    assert begun * frequency == pytest.approx(np.arccos(0.8) / (2.0 * np.pi), abs=step**2 * np.pi / 3.0)


def test_sample_without_section_is_unavailable(analysis: CampaignAnalysis) -> None:
    """A cell whose section was not kept says so."""
    with pytest.raises(UnavailableError, match="no section is stored"):
        load_arrival(analysis, 6, 9.0)


def test_published_means_are_shown_for_the_published_sand_where_contents_match(analysis: CampaignAnalysis) -> None:
    """Only contents of the published table are set beside it, and only of its sand in its box."""
    assert published_velocities(analysis) == []
    with open_campaign(TUTORIAL) as campaign:
        assert [content for content, _ in published_velocities(campaign.analyse())] == [0.66, 2.55, 5.0, 9.0]
        for shift, count in ((2e-7, 4), (5e-5, 0)):  # percent: contents are equal to six decimals, or differ
            beside = campaign.analyse()
            vars(beside)["vs"] = beside.vs.assign_coords(content=beside.vs["content"] + shift)
            assert len(published_velocities(beside)) == count


def test_symbols_are_upright_where_they_are_names() -> None:
    """Names of several letters are upright, single letters are not, indices are kept together."""
    assert _symbol("path_normalized_connectivity") == "$C_{d,n}$"
    assert _symbol("path_longest_bonded_run") == r"$\mathrm{QLLC}$"
    assert "\N{MINUS SIGN} 338" in _law_text("C_{d,n}", 623.0, -1.01, -338.0)


def test_colours_differ_in_brightness() -> None:
    """Cement, clusters and sand differ in brightness, so that they can be told apart without colour."""
    brightness = [float(np.dot(to_rgb(colour), (0.2126, 0.7152, 0.0722))) for colour in COLOURS.values()]
    assert min(brightness[:2]) - max(brightness[2:]) > 0.25


DRAWN_BY_A_USER = """
import sys
from calcidem.app.campaign.opened import open_campaign

with open_campaign(sys.argv[1]) as campaign:
    for name in sys.argv[2:]:
        figure = getattr(campaign.plot, name)()
        figure.savefig(f"{name}.png")
        figure.savefig(f"{name}.svg", metadata={"Date": None})
    if "signals" in sys.argv:
        campaign.plot.movie("wave.gif", seed=1, content=5.0, frames=2)
"""


@pytest.mark.parametrize("names", [("vs_range",), pytest.param(("vs_range", "signals"), marks=pytest.mark.full)])
def test_a_users_settings_of_matplotlib_change_no_figure(
    small_database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...]
) -> None:
    """Figures drawn in Python are the same bytes with a matplotlibrc that asks for LaTeX, which is not installed."""
    settings = ("text.usetex: True", "font.family: serif", "axes.grid: False", "xtick.direction: in", "backend: TkAgg")
    (tmp_path / "matplotlibrc").write_text("\n".join(settings), encoding="utf-8")
    (own := tmp_path / "own").mkdir()
    command = [sys.executable, "-c", DRAWN_BY_A_USER, str(small_database), *names]
    variables = {"MATPLOTLIBRC": str(tmp_path / "matplotlibrc"), "PATH": str(tmp_path / "none")}
    subprocess.run(command, check=True, cwd=own, env=os.environ | variables)
    monkeypatch.setattr("sys.argv", ["-c", str(small_database), *names])
    exec(DRAWN_BY_A_USER, {})  # noqa: S102 - the same program here, in an empty folder and without settings
    written = {path.name: path.read_bytes() for path in own.iterdir()}
    assert len(written) == 2 * len(names) + ("signals" in names)
    assert written == {path.name: path.read_bytes() for path in Path.cwd().iterdir()}
