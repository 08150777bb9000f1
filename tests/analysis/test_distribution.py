import numpy as np
import pytest
import xarray as xr
from campaign_cells import campaign_cells
from scipy import stats

from calcidem.analysis.distribution import Distribution, describe_contents, tabulate
from calcidem.app.report.tables import count_reasons
from calcidem.storage.records import NOT_PLANNED


def matrix(values: list[list[float]], contents: list[float]) -> xr.DataArray:
    """Make a velocity matrix with seeds 0, 1, ..."""
    return xr.DataArray(
        np.array(values), dims=("seed", "content"), coords={"seed": range(len(values)), "content": contents}
    )


def test_description_is_made_of_scipys_statistics() -> None:
    """Every number of a description of 116 values is the one SciPy or NumPy gives."""
    values = np.random.default_rng(1).normal(1211, 261, 116)
    found = Distribution.of_sample(values)
    assert found.n == 116
    assert found.mean == pytest.approx(values.mean())
    assert found.standard_deviation == pytest.approx(stats.tstd(values))
    assert found.skewness == pytest.approx(stats.skew(values))
    assert found.kurtosis == pytest.approx(stats.kurtosis(values, fisher=False))
    assert found.jarque_bera == pytest.approx(stats.jarque_bera(values).statistic)
    fitted = stats.norm(values.mean(), stats.tstd(values))
    np.testing.assert_allclose(found.normal_density([1000, 1200]), fitted.pdf([1000, 1200]))


def test_all_intervals_hold_the_middle_of_a_normal_sample() -> None:
    """Intervals of mean and deviation hold them, and the prediction interval is wider than the mean's."""
    found = Distribution.of_sample(np.random.default_rng(2).normal(500, 50, 116))
    assert found.mean_interval.contains(found.mean)
    assert found.standard_deviation_interval.contains(found.standard_deviation)
    assert found.prediction_interval.half_width > 5 * found.mean_interval.half_width


def test_outcomes_are_counted_apart() -> None:
    """A cell that failed and one that was not computed are both without velocity and are counted apart."""
    nan = float("nan")
    vs = matrix([[200.0, nan], [210.0, nan], [nan, 900.0]], [0.11, 5.0])
    status = vs.copy(data=np.array([["done", "no_arrival"], ["done", "unstable"], ["", "done"]]))
    rows = describe_contents(campaign_cells(vs, status))
    assert [(row.content, row.vs.n, row.missing, row.failed) for row in rows] == [
        (0.11, 2, 1, 0),
        (5.0, 1, 0, 2),
    ]


def test_seeds_that_a_content_does_not_get_are_no_gaps() -> None:
    """A campaign that adds seeds until intervals are narrow gives each content another number of them."""
    nan = float("nan")
    vs = matrix([[200.0, 800.0], [210.0, 900.0], [nan, 850.0], [nan, nan]], [0.11, 5.0])
    codes = [["done", "done"], ["done", "done"], [NOT_PLANNED, "done"], [NOT_PLANNED, "pending"]]
    status = vs.copy(data=np.array(codes))
    rows = describe_contents(campaign_cells(vs, status))
    assert [(row.vs.n, row.missing, row.failed) for row in rows] == [(2, 0, 0), (3, 1, 0)]
    assert (
        count_reasons(
            np.char.replace(status.to_numpy().astype(str), "pending", "").astype(object).ravel(),
            np.full(8, ""),
            np.tile([0.11, 5.0], 4),
        )
        == []
    )


@pytest.mark.parametrize(
    ("outcomes", "counts"),
    [
        (["", "done", "unstable", "done"], (1, 0, 0)),  # a velocity of one seed is that of all
        (["", "unstable", "", "unstable"], (0, 0, 1)),
        (["", "", "", ""], (0, 1, 0)),
    ],
)
def test_without_cement_all_seeds_are_one_cell(outcomes: list[str], counts: tuple[int, int, int]) -> None:
    """The best outcome of any seed counts, once; other contents count each seed."""
    vs = matrix([[200.0 if each == "done" else float("nan")] * 2 for each in outcomes], [0.0, 0.05])
    rows = describe_contents(campaign_cells(vs, vs.copy(data=np.array([[each, each] for each in outcomes]))))
    of_seeds = outcomes.count("done"), outcomes.count(""), outcomes.count("unstable")
    assert [(row.vs.n, row.missing, row.failed) for row in rows] == [counts, of_seeds]
    columns = np.repeat(np.array(outcomes, object), 2), np.full(2 * len(outcomes), "silent"), np.tile([0.0, 0.05], 4)
    failures = [count for *_, count in count_reasons(*columns)]
    assert failures == [1 + outcomes.count("unstable")] * ("unstable" in outcomes)


def test_gaps_count_as_not_computed() -> None:
    """A cell on its way is no failure, and a second seed without cement is no gap."""
    rows = describe_contents(
        campaign_cells(matrix([[200.0, 210.0, float("nan")], [200.0, 220.0, 900.0]], [0.0, 0.11, 5.0]))
    )
    assert [row.missing for row in rows] == [0, 0, 1]
    assert [row.failed for row in rows] == [0, 0, 0]


def test_malformed_matrices_are_refused() -> None:
    """Foreign dimensions and missing values are refused."""
    vs = matrix([[200.0, 300.0]], [0.11, 5.0])
    with pytest.raises(ValueError, match="seed"):
        describe_contents(campaign_cells(vs.rename(seed="run")))
    with pytest.raises(ValueError, match="finite"):
        Distribution.of_sample([1.0, float("nan")])


def test_dimension_order_does_not_matter() -> None:
    """A matrix given as (content, seed) is described like its transpose."""
    vs = matrix([[200.0, 900.0], [220.0, 950.0], [230.0, 990.0]], [0.11, 5.0])
    assert repr(describe_contents(campaign_cells(vs))) == repr(describe_contents(campaign_cells(vs.T)))


def test_a_content_without_any_velocity_is_described_by_nan() -> None:
    """A column of nothing but gaps gives n = 0 and NaN, and does not disturb the others."""
    rows = describe_contents(campaign_cells(matrix([[200.0, float("nan")], [220.0, float("nan")]], [0.11, 5.0])))
    assert rows[0].vs.mean == pytest.approx(210.0)
    assert rows[1].vs.n == 0
    assert np.isnan([rows[1].vs.mean, rows[1].vs.standard_deviation, rows[1].vs.skewness]).all()


def test_the_uncemented_sample_has_no_scatter() -> None:
    """At 0 % all seeds are the same sample, with zero deviation and no skewness."""
    found = Distribution.of_sample(np.full(116, 169.73))
    assert (found.mean, found.standard_deviation) == (169.73, 0.0)
    assert np.isnan([found.skewness, found.jarque_bera]).all()
    assert found.standard_deviation_interval.high == 0.0


def test_the_table_holds_the_records() -> None:
    """The table has each record's numbers at its content, intervals as bounds, and units."""
    vs = matrix(np.random.default_rng(3).normal(800, 90, (12, 2)).tolist(), [3.17, 4.0])
    rows = describe_contents(campaign_cells(vs))
    table = tabulate(rows)
    for row in rows:
        column = table.sel(content=row.content)
        assert column["n"] == row.vs.n
        assert column["mean"] == row.vs.mean
        assert column["jarque_bera"] == row.vs.jarque_bera
        assert column["p_small_sample"] == row.vs.p_small_sample
        assert column["mean_interval"].sel(bound="low") == row.vs.mean_interval.low
        assert column["prediction_interval"].sel(bound="high") == row.vs.prediction_interval.high
    assert table["mean_interval"].attrs["units"] == "m/s"
    assert table["skewness"].attrs["units"] == "1"
