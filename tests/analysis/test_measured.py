"""A campaign beside velocities measured in a laboratory, on numbers that are counted by hand."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from campaign_cells import campaign_cells

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError
from calcidem.analysis.distribution import describe_contents
from calcidem.analysis.figures import velocities
from calcidem.analysis.measured import Target, group_specimens, misfits
from calcidem.app.report.sections import _measured_table

VS = xr.DataArray(
    [[190.0, 290.0], [200.0, 300.0], [210.0, 310.0]],
    dims=("seed", "content"),
    coords={"seed": [1, 2, 3], "content": [1.0, 3.0]},
)
"""Means of 200 and 300 m/s, standard deviations of 10 m/s."""


def test_misfits_are_those_counted_by_hand() -> None:
    """At the campaign's content, between two of them, and outside, where nothing is said."""
    measured = (Target(4.0, 500.0), Target(2.0, 200.0, 20.0, 3), Target(1.0, 210.0))
    first, second = misfits(describe_contents(campaign_cells(VS)), measured)
    assert (first.mean, first.interpolated, second.mean, second.interpolated) == (200.0, False, 250.0, True)
    assert first.difference == pytest.approx(-10.0 / 210.0)
    assert first.standard_errors == pytest.approx(-10.0 / (10.0 / np.sqrt(3.0)))
    assert np.isnan(first.deviation_ratio)
    assert second.standard_errors == pytest.approx(50.0 / np.sqrt((10.0**2 + 20.0**2) / 3.0))
    assert second.deviation_ratio == pytest.approx(0.5)
    assert second.difference == pytest.approx(0.25)
    assert misfits(describe_contents(campaign_cells(VS * np.nan)), measured) == ()


def test_specimens_of_nearly_one_content_are_joined() -> None:
    """Mean and standard deviation are those of all samples; other stresses and means of several stay apart."""
    rows = [Target(c, v, samples=1) for c, v in ((2.0, 100.0), (2.1, 110.0), (2.3, 120.0), (2.4, 200.0))]
    (joined, members), (alone, _) = group_specimens([rows[3], *rows[:3]])
    assert (joined, members) == (Target(2.133, 110.0, 10.0, 3), tuple(rows[:3]))
    assert (alone.vs, alone.sd, alone.samples) == (200.0, None, 1)
    assert len(group_specimens([replace(rows[0], stress=5e4), replace(rows[0], stress=1e5)])) == 2
    between = Target(2.05, 300.0, 10.0, 5)  # a mean stays apart and separates no specimens
    assert [members for _, members in group_specimens([*rows[:3], between])] == [tuple(rows[:3]), (between,)]
    several = [Target(2.0, 100.0, 10.0, 5), Target(2.1, 110.0, 10.0, 5)]
    assert [joined for joined, _ in group_specimens(several)] == several
    values = np.array([90.0, 100.0, 110.0]), np.array([100.0, 120.0])
    ((pooled, _),) = group_specimens([Target(2.0, v.mean(), float(v.std(ddof=1)), len(v)) for v in values])
    assert (pooled.vs, pooled.sd) == pytest.approx((np.concatenate(values).mean(), np.concatenate(values).std(ddof=1)))


def test_specimens_are_compared_with_the_interval_of_new_samples() -> None:
    """Each at its own content; the error of one specimen is the campaign's scatter."""
    low, high = (row.vs.prediction_interval for row in describe_contents(campaign_cells(VS)))
    edge = 0.5 * (low.high + high.high)  # at 2 %, between the contents
    rows = [Target(2.0, edge - 0.1, samples=1), Target(2.0, edge + 0.1, samples=1), Target(3.0, 300.0, samples=1)]
    first, second = misfits(describe_contents(campaign_cells(VS)), rows)
    assert (first.outside, first.compared, first.measured.samples) == (1, 2, 2)
    assert (second.outside, second.compared) == (0, 1)
    (one,) = misfits(describe_contents(campaign_cells(VS)), [Target(3.0, 310.0, samples=1)])
    assert one.standard_errors == pytest.approx(-10.0 / np.hypot(10.0 / np.sqrt(3.0), 10.0))


def test_the_sample_without_cement_is_compared_with_its_error() -> None:
    """All seeds are one sample at 0 %: the error of its velocity is that of the difference, and no scatter is shown."""
    vs = xr.DataArray([[200.0, 290.0], [200.0, 310.0]], {"seed": [1, 2], "content": [0.0, 2.0]}, ("seed", "content"))
    rows = [Target(0.0, 230.0, samples=1), Target(0.5, 225.0, 20.0, 5)]
    first, second = misfits(describe_contents(campaign_cells(vs, error=0.05 * vs / vs)), rows)
    assert first.standard_errors == pytest.approx(-30.0 / 10.0, rel=0.02)
    assert (first.outside, first.compared) == (1, 1)
    assert np.isnan(first.standard_deviation)
    assert second.deviation_ratio == pytest.approx(0.25 * 200**0.5 / 20.0)


def test_every_measured_point_lies_within_the_axes(analysis: CampaignAnalysis) -> None:
    """Also one far above the samples, and every specimen of a group beside its mean."""
    measured = (Target(2.0, 480.0, samples=1), Target(2.0, 520.0, samples=1), Target(20.0, 2900.0, 100.0, 5))
    for figure in (
        velocities.draw_range(analysis.cells, analysis.distributions, measured=measured),
        velocities.draw_methods(analysis.cells, measured),
    ):
        axes = figure.axes[0]
        assert axes.get_ylim()[1] > 3000.0
        assert axes.get_xlim()[1] > 20.0
        assert "measured specimen" in axes.get_legend_handles_labels()[1]


def test_points_beyond_both_panels_are_in_the_second() -> None:
    """Where low contents have a panel of their own, the other one has all above them, far points included."""
    contents = [0.1, 0.3, 0.6, 3.0, 9.0]
    vs = xr.DataArray(
        np.multiply.outer([190.0, 200.0, 210.0], np.arange(1.0, 6.0)),
        dims=("seed", "content"),
        coords={"seed": [1, 2, 3], "content": contents},
    )
    cells = xr.Dataset({"vs": vs, "vs_error": 0.0 * vs + 0.01, "pulse_effect": 0.0 * vs})
    measured = (Target(0.2, 480.0, samples=1), Target(20.0, 2900.0, samples=1))
    low, high = velocities.draw_range(cells, describe_contents(campaign_cells(vs)), measured=measured).axes
    assert low.get_xlim()[1] < 1.0
    assert low.get_ylim()[1] > 480.0
    assert (high.get_xlim()[1] > 20.0, high.get_ylim()[1] > 2900.0) == (True, True)
    for panel in (low, high):
        assert "measured specimen" in panel.get_legend_handles_labels()[1]


def test_measured_velocities_lie_over_every_figure_of_vs_against_content(analysis: CampaignAnalysis) -> None:
    """They are named in the legend of the range and of the readings, and marked in the histogram of their content."""
    measured = (Target(0.66, 380.0, 30.0, 5), Target(9.0, 2000.0))
    figures = (
        velocities.draw_range(analysis.cells, analysis.distributions, measured=measured),
        velocities.draw_methods(analysis.cells, measured),
    )
    for figure in figures:
        names = {text for axes in figure.axes for text in axes.get_legend_handles_labels()[1]}
        assert any(name.startswith("measured mean") for name in names)
    plain, marked = (velocities.draw_histograms(analysis.vs, analysis.distributions, m) for m in ((), measured))
    more = [len(two.lines) - len(one.lines) for one, two in zip(plain.axes, marked.axes, strict=True)]
    assert sum(more) == sum(
        any(abs(t.content - row.content) < 1e-6 for t in measured) for row in analysis.distributions
    )
    assert [len(figure.legends) for figure in (plain, marked)] == [0, 1]
    (far,) = (axes for axes in marked.axes if axes.get_title(loc="left").endswith(" 9 %"))
    assert far.get_xlim()[1] > 2000.0  # a mark outside of the samples widens its panel


def test_a_report_has_the_misfit_only_where_something_was_measured(analysis: CampaignAnalysis) -> None:
    """Without a file there is no table; with one it has a row for each content in the campaign's range."""
    assert _measured_table(analysis) is None
    table = _measured_table(replace(analysis, measured=(Target(0.66, 380.0, 30.0, 5), Target(99.0, 2000.0))))
    assert table is not None
    assert [row[0] for row in table.rows] == ["0.66"]
    assert "beyond the campaign's contents, and not compared: 99 % (2000 m/s)" in table.caption
    assert "of 1 measured values are outside the interval of 95 % of new samples" in table.caption
    both = (Target(0.66, 380.0), Target(2.55, 900.0))
    differences = [one.difference for one in misfits(analysis.distributions, both)]
    assert (compared := _measured_table(replace(analysis, measured=both))) is not None
    mean_square = f"{100.0 * np.sqrt(np.mean(np.square(differences))):.1f} %"
    assert f"root mean square of the differences of the means {mean_square}" in compared.caption
    stress = analysis.config["packing"]["stress"]
    foreign = _measured_table(replace(analysis, measured=(Target(0.66, 380.0, samples=1, stress=2 * stress),)))
    assert foreign is not None
    assert f"Measured under {2 * stress / 1e3:g} kPa, computed under {stress / 1e3:g} kPa" in foreign.caption
    assert len(set(table.header)) == len(table.header)
    with pytest.raises(UnavailableError, match="no measured velocity is within"):
        _measured_table(replace(analysis, measured=(Target(99.0, 2000.0),)))


def test_means_of_unknown_numbers_keep_their_scatter() -> None:
    """Two laboratories that do not say how many samples they had: the joined standard deviation is not theirs apart."""
    ((joined, _),) = group_specimens([Target(1.0, 200.0, 30.0), Target(1.0, 202.0, 40.0)])
    assert joined == Target(1.0, 201.0, pytest.approx(np.sqrt((30.0**2 + 40.0**2) / 2.0 + 1.0)), None)
    ((joined, _),) = group_specimens([Target(1.0, 200.0), Target(1.0, 202.0, 40.0, 10)])
    assert joined.samples is None


@pytest.mark.parametrize("samples", [None, 10])
def test_a_mean_of_unknown_scatter_leaves_that_of_its_group_unknown(samples: int | None) -> None:
    """The difference of two means is no standard deviation of samples, nor has a mean of several none of its own."""
    for other in (Target(5.0, 1120.0, None, samples), Target(5.0, 1120.0, 250.0, samples)):
        ((joined, _),) = group_specimens([Target(5.0, 1100.0, None, samples), other])
        assert (joined.vs, joined.sd) == (1110.0, None)


def test_a_content_with_one_velocity_has_no_scatter_to_compare_with() -> None:
    """Neither there nor beside it; without cement it would be the whole sample."""
    vs = xr.DataArray(
        [[200.0, 290.0, 390.0], [210.0, np.nan, 410.0]],
        {"seed": [1, 2], "content": [1.0, 2.0, 3.0]},
        ("seed", "content"),
    )
    beside, at = misfits(
        describe_contents(campaign_cells(vs)), [Target(1.5, 245.0, 20.0, 5), Target(3.0, 400.0, 20.0, 5)]
    )
    assert np.isnan([beside.standard_deviation, beside.deviation_ratio]).all()
    assert at.deviation_ratio == pytest.approx(np.sqrt(200.0) / 20.0)
    assert np.isnan(beside.standard_errors)  # the error of a mean of one velocity is unknown, not zero
    assert at.standard_errors == pytest.approx(0.0)
