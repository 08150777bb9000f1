"""Numbers of the pages of reproduction, computed again from the shipped samples with NumPy and SciPy alone."""

import re
import runpy
import sys
import tomllib
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy import interpolate, optimize, sparse, spatial, special, stats

import calcidem
from calcidem.analysis import packing_graph
from calcidem.analysis.measured import published_study
from calcidem.analysis.velocity import are_samples
from calcidem.app.campaign.opened import open_campaign
from calcidem.storage.records import PackingRecord

sys.path.append(str(Path(__file__).parents[2] / "docs" / "reproduction"))

from variance import variance_parts

PAGE = Path(__file__).parents[2] / "docs" / "reproduction.md"
README = PAGE.parents[1] / "README.md"
SCATTER, CONDUCTANCE = (PAGE.parent / "reproduction" / f"{name}.md" for name in ("scatter", "conductance"))
FEATURES = {
    "N": "path_contacts",
    "N_h": "path_hertz_contacts",
    "N_LPB": "path_bonded_contacts",
    "LP": "path_bonded_fraction",
    "QLLC": "path_longest_bonded_run",
    "PLLC": "path_longest_bonded_run_fraction",
    "C_d": "path_connectivity",
    "C_d,n": "path_normalized_connectivity",
}
STAGES = {"I": (0.11, 0.66), "II": (1.24, 3.17), "III": (4.0, 6.0), "IV": (7.0, 9.0)}
CALIBRATED = (0.11, 0.66, 2.55, 5.0, 9.0)

Array = NDArray[np.float64]
Expected = dict[str, list[float] | str]
"""Of a row by the header of its column: numbers in their order, or a word."""


def tables(page: Path) -> Iterator[tuple[list[str], list[list[str]]]]:
    """Headers and rows of all tables of a page."""
    for block in re.findall(r"(?:^\|.*\n)+", page.read_text(encoding="utf-8"), flags=re.MULTILINE):
        rows = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in block.splitlines()]
        yield rows[0], rows[2:]


def table_with(*headers: str, page: Path = PAGE) -> tuple[list[str], list[list[str]]]:
    """The one table of the page that has these columns."""
    (found,) = [table for table in tables(page) if set(headers) <= set(table[0])]
    return found


def check_said(*sentences: str, page: Path = PAGE) -> None:
    """The page has each of these sentences, wherever its lines break."""
    text = re.sub(r"\n(?:> |\* )? *", " ", page.read_text(encoding="utf-8"))
    for sentence in sentences:
        assert sentence in text, sentence


def numbers_in(cell: str) -> list[tuple[float, float]]:
    """Numbers of a cell, each with half a unit of its last digit."""
    found = re.findall(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?", cell)
    return [(float(text), 0.5 * 10.0 ** -len((text.split("e")[0] + ".").split(".")[1])) for text in found]


def check(header: list[str], row: list[str], expected: Expected) -> None:
    """Each column that is expected is as printed, up to rounding; columns of one name come in their order."""
    for name, value in expected.items():
        cell = row[header.index(name)]
        if isinstance(value, str):
            assert cell == value, (row, name)
            continue
        printed = numbers_in(cell)
        assert len(printed) == len(value), (row, name)
        for (number, half), exact in zip(printed, value, strict=True):
            if "e" in cell:  # two significant digits
                assert number == pytest.approx(exact, rel=0.06), (row, name)
            else:
                assert abs(number - exact) <= half * 1.001 + 1e-9, (row, name, exact)


@pytest.fixture(scope="module")
def cells() -> xr.Dataset:
    """Give the shipped campaign."""
    return calcidem.load_paper_campaign()


@pytest.fixture(scope="module")
def published() -> dict[float, dict[str, float]]:
    """Give Table 3 of the paper, by content."""
    text = resources.files("calcidem.analysis").joinpath("published.toml").read_text(encoding="utf-8")
    return {row["content"]: row["vs"] for row in tomllib.loads(text)["contents"] if "vs" in row}


def printed_column(published: dict[float, dict[str, float]], name: str) -> Array:
    """One column of Table 3."""
    return np.array([row[name] for row in published.values()])


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def sampling_variance(kurtosis: Array, n: Array) -> Array:
    """Variance of the logarithm of a standard deviation of n values."""
    return (kurtosis - 1) / (4 * n)


def values_at(cells: xr.Dataset, content: float) -> Array:
    """Velocities of a content."""
    vs = cells["vs"].sel(content=content).to_numpy()
    return np.asarray(vs[np.isfinite(vs)])


def bonett(values: Array) -> tuple[float, float]:
    """Interval of a standard deviation, Bonett 2006, Eq. 3 with its small-sample correction."""
    n, z = values.size, stats.norm.ppf(0.975)
    middle = stats.trim_mean(values, 1 / (2 * np.sqrt(n - 4)))
    kurtosis = n * np.sum((values - middle) ** 4) / np.sum((values - values.mean()) ** 2) ** 2
    c = n / (n - z)
    error = c * np.sqrt((kurtosis - (n - 3) / n) / (n - 1))
    low, high = (float(np.sqrt(c * values.var(ddof=1) * np.exp(sign * z * error))) for sign in (-1, 1))
    return low, high


def test_means_scatter_growth_and_shape_of_the_page(
    cells: xr.Dataset, published: dict[float, dict[str, float]]
) -> None:
    """Means and sd with their intervals, sd over mean, rates of growth, moments and verdicts are those of the file."""
    header, rows = table_with("scatter (95 %)")
    assert {float(row[0].strip("*")) for row in rows} == set(published)
    for row in rows:
        content = float(row[0].strip("*"))
        values = values_at(cells, content)
        half = special.stdtrit(values.size - 1, 0.975) * values.std(ddof=1) / np.sqrt(values.size)
        scatter = np.array([values.std(ddof=1), *bonett(values)])
        target = values.mean() * published[content]["standard_deviation"] / published[content]["mean"]
        check(
            header,
            row,
            {
                "read of 116": [values.size],
                "mean, m/s (95 %)": [values.mean(), values.mean() - half, values.mean() + half],
                "difference, %": [100 * (values.mean() / published[content]["mean"] - 1)],
                "sd, m/s": [scatter[0]],
                "scatter (95 %)": (scatter / target).tolist(),
            },
        )
        assert float(cells["frequency"].sel(content=content)[0]) == published_study().frequencies[content]
    header, rows = table_with("stage")
    for row in rows:
        low, high = STAGES[row[0]]
        rise = values_at(cells, high).mean() - values_at(cells, low).mean()
        check(header, row, {"rate between its end points, m/s per %": [rise / (high - low)]})
    header, rows = table_with("kurtosis", "normal here")
    for row in rows:
        values = values_at(cells, float(row[0]))
        test = stats.jarque_bera(values)
        check(
            header,
            [re.sub(r" \(.*", "", cell) for cell in row],
            {
                next(name for name in header if name.startswith("skewness")): [stats.skew(values)],
                "published": [published[float(row[0])]["skewness"]],
                "kurtosis": [stats.kurtosis(values, fisher=False)],
                "normal here": "yes" if test.pvalue >= 0.05 else "no",
                "printed": "yes" if published[float(row[0])]["normal"] else "no",
            },
        )


def test_sentences_on_means_and_scatter(cells: xr.Dataset, published: dict[float, dict[str, float]]) -> None:
    """Counts, errors, largest differences, significance of the scatter, and times of travel are those of the file."""
    vs = cells["vs"].to_numpy()
    read = np.isfinite(vs)
    measured = [values_at(cells, content) for content in published]
    mean, deviation = (np.array([statistic(one) for one in measured]) for statistic in (np.mean, deviate))
    printed, printed_deviation = (printed_column(published, name) for name in ("mean", "standard_deviation"))
    off, scatter = mean / printed - 1, deviation / mean * printed / printed_deviation
    distinct = are_samples(vs, cells["content"])
    whole, reading, numerical = (
        float(np.median(cells[name].to_numpy()[distinct])) for name in ("vs_error", "reading_error", "numerical_error")
    )
    kurtosis, size = (np.array([f(one) for one in measured]) for f in (fourth_moment, len))
    noise = sampling_variance(kurtosis, size) + sampling_variance(
        printed_column(published, "kurtosis"), np.full(16, 116)
    )
    z = np.log(scatter) / np.sqrt(noise)
    p = 2 * stats.norm.sf(np.abs(z))
    assert [content for content, one in zip(published, p, strict=True) if 16 * one < 0.05] == [8.0, 9.0]
    assert [content for content, one in zip(published, off, strict=True) if abs(one) > 0.05] == []
    assert [content for content, one in zip(published, scatter, strict=True) if one > 1.33] == [0.55, 8.0, 9.0]
    refused, unread = cells["reading_error"].to_numpy()[~read] > 0.5, (~read).mean(axis=0)
    bound = float(cells["pulse_effect"].max())
    check_said(
        f"{read.sum():,} of {vs.size:,}; no bond broke",
        f"At 0 % (4 kHz) all samples are one, of {vs[0, 0]:.0f} m/s",
        f"median of distinct samples {100 * whole:.1f} % (reading {100 * reading:.1f} %, "
        f"simulation {100 * numerical:.2f} %, pulse at most {100 * bound:.1f} %)",
        f"within {100 * np.abs(off).max():.1f} % of the paper's, rms {100 * rms(off):.1f} %",
        f"{scatter.min():.2f} to {scatter.max():.2f} of the paper's, within 0.75 to 1.33 at "
        f"{np.sum((scatter >= 0.75) & (scatter <= 1.33))} of 16 contents",
        f"is {100 * off.max():+.1f} % at {list(published)[int(off.argmax())]} %",
        f"(p = {p.min():.1g}, {16 * p.min():.1g} for 16 tests)",
        f"are {100 * (~read).mean():.1f} % of all and {100 * unread.max():.0f} % at "
        f"{cells['content'].to_numpy()[unread.argmax()]:g} %. "
        f"{refused.sum()} of {refused.size} have",
    )
    assert not (cells["broken_bonds"] > 0).any()
    check_said(f"The 1,972 cells took {cells['seconds'].sum().item() / 60:.0f} CPU minutes", page=README)
    others = ~np.isin(list(published), CALIBRATED)
    errors = [
        (100 * rms((means / printed - 1)[others]), rms(np.log(deviations / printed_deviation)[others]))
        for means, deviations in [(mean, deviation), *baselines(published, ~others, printed, printed_deviation)]
    ]
    (own, own_scatter), *interpolated = errors
    (low, low_scatter), (high, high_scatter) = (one(np.array(interpolated), axis=0) for one in (np.min, np.max))
    assert others.sum() == 11
    check_said(
        f"their rms difference is {low:.1f} to {high:.1f} % instead of {own:.1f} %",
        f"of the logarithm is {low_scatter:.3f} to {high_scatter:.3f} instead of {own_scatter:.3f}",
    )


def baselines(
    published: dict[float, dict[str, float]], known: NDArray[np.bool_], *columns: Array
) -> Iterator[list[Array]]:
    """Means and deviations of Table 3 interpolated between the calibrated contents, in three ways."""
    x = np.array(list(published))
    yield [np.interp(x, x[known], y[known]) for y in columns]
    yield [np.exp(np.interp(x, x[known], np.log(y[known]))) for y in columns]
    log = np.log(x)
    yield [np.exp(interpolate.PchipInterpolator(log[known], np.log(y[known]))(log)) for y in columns]


def test_scatter_of_both_shipped_campaigns(cells: xr.Dataset, published: dict[float, dict[str, float]]) -> None:
    """Scatter of velocities and stiffness, and the parts of its variance."""
    loud = calcidem.load_paper_campaign("paper-as-printed")
    for content in (8.0, 9.0):  # there the error of the reading is more than half of the variance
        column = cells.sel(content=content).where(cells["vs"].sel(content=content).notnull())
        assert float((column["reading_error"] ** 2).mean() / np.log(column["vs"]).var(ddof=1)) > 0.5
    header, rows = table_with("stiffness, part of variance", page=SCATTER)
    for row in rows:
        content = float(row[0])
        quiet = {
            name: cells[name].sel(content=content).to_numpy()
            for name in ("vs", "effective_vs", "static_speed", "reading_error")
        }
        known = np.isfinite(quiet["vs"])
        log, stiffness = np.log(quiet["vs"][known]), np.log(quiet["static_speed"][known])
        square = np.mean(quiet["reading_error"][known] ** 2)
        printed = published[content]
        check(
            header,
            row,
            {
                "printed sd / mean": [printed["standard_deviation"] / printed["mean"]],
                "quiet pulse": [deviate(quiet["vs"][known]) / quiet["vs"][known].mean()],
                "5 m/s": [deviate(values_at(loud, content)) / values_at(loud, content).mean()],
                "`effective_vs`": [deviate(quiet["effective_vs"]) / quiet["effective_vs"].mean()],
                "`static_speed`": [deviate(quiet["static_speed"]) / quiet["static_speed"].mean()],
                "reading, part of variance": [float(square / log.var(ddof=1))],
                "stiffness, part of variance": [float(np.corrcoef(log, stiffness)[0, 1] ** 2)],
            },
        )


def test_sentences_on_the_parts_of_the_scatter(cells: xr.Dataset, published: dict[float, dict[str, float]]) -> None:
    """The pulse as part of the variance; the campaign of the printed pulse beside Table 3."""
    loud = calcidem.load_paper_campaign("paper-as-printed")
    contents = np.array(list(published))
    quiet, noisy = (one.sel(content=contents) for one in (cells, loud))
    variance, noisy_variance = (np.log(one["vs"]).var("seed", ddof=1).to_numpy() for one in (quiet, noisy))
    pulse = quiet["pulse_effect"].max("seed").to_numpy() ** 2 / variance
    effect = noisy["pulse_effect"].max("seed").to_numpy() / np.sqrt(noisy_variance)
    low, high = effect[contents < 4], effect[contents > 4]
    mean = np.array([values_at(loud, content).mean() for content in contents])
    off = mean / printed_column(published, "mean") - 1
    scatter = np.array([deviate(values_at(loud, content)) for content in contents]) / mean
    scatter *= printed_column(published, "mean") / printed_column(published, "standard_deviation")
    broken = noisy["broken_bonds"].to_numpy() > 0
    check_said(
        f"the quiet one causes at most {pulse.max():.2f} of the variance. The stated effect of 5 m/s is "
        f"{low.min():.1f} to {low.max():.1f} times the standard deviation between seeds up to 3.17 %. "
        f"It is {effect[contents == 4][0]:.1f} at 4 % and at most {high.max():.1f} above",
        f"means agree within {100 * np.abs(off).max():.1f} % and sd / mean is {scatter.min():.2f} to "
        f"{scatter.max():.2f} of the published, but {broken.sum():,} of {broken.size:,} cemented cells broke bonds",
        page=SCATTER,
    )


def test_the_conclusions_of_the_paper(cells: xr.Dataset) -> None:
    """Growth, C_d,n of three samples of 5 %, its correlation within contents, and the law of both campaigns."""
    text = SCATTER.read_text(encoding="utf-8")
    loud = calcidem.load_paper_campaign("paper-as-printed")
    rates = [
        (values_at(loud, high).mean() - values_at(loud, low).mean()) / (high - low) for low, high in STAGES.values()
    ]
    assert f"holds: {', '.join(f'{rate:.0f}' for rate in rates)} m/s per %" in text
    for one, words in ((cells, "0.52, 0.41, 0.23"), (loud, "0.32, 0.19 and 0.28")):
        three = one.sel(content=5.0).dropna("seed", subset=["vs"]).sortby("vs")["path_normalized_connectivity"]
        assert words in text
        numbers = [float(number) for number in re.findall(r"[\d.]+", words)]
        assert three[[0, three.size // 2, -1]].to_numpy() == pytest.approx(numbers, abs=0.00501)
    for one, words in ((cells, "-0.68 to -0.08"), (loud, "-0.39 to -0.06")):
        by_content = [spearman_at(one, "path_normalized_connectivity", content) for content in one["content"][1:]]
        assert f"{min(by_content):.2f} to {max(by_content):.2f}" == words
        assert words in text
    for one, skewed in ((cells, "0.45 to 4"), (loud, "1.24 to 5")):
        vs = one["vs"].sel(content=slice(0.1, None))
        deviation = vs.std("seed", ddof=1)
        largest = [float(by_content.idxmax()) for by_content in (deviation, deviation / vs.mean("seed"))]
        assert all(STAGES["III"][0] <= content <= STAGES["III"][1] for content in largest)
        assert f"holds: sd largest at {largest[0]:g} %, sd / mean at {largest[1]:g} % |" in text
        first, last = map(float, skewed.split(" to "))
        for content in vs["content"].sel(content=slice(first, last)):
            values = values_at(one, float(content))
            assert stats.skew(values) > 0
            assert stats.jarque_bera(values).pvalue < 0.05
        assert f"| holds at {skewed} % |" in text
    for one in (cells, loud):
        vs, x = (one[name].to_numpy() for name in ("vs", "path_normalized_connectivity"))
        known = np.isfinite(vs)
        known[1:, 0] = False
        (a, b, c), _ = optimize.curve_fit(lambda x, a, b, c: a * x**b + c, x[known], vs[known], p0=(500, -1, -200))
        assert f"holds: {a:.0f} C^{b:.2f} - {-c:.0f}" in text


def spearman_at(cells: xr.Dataset, name: str, content: float) -> float:
    """Rank correlation of a feature with Vs at a content."""
    column = cells.sel(content=content)
    return float(stats.spearmanr(column[name], column["vs"], nan_policy="omit").statistic)


@pytest.fixture(scope="module")
def variants() -> xr.Dataset:
    """Give velocities and features of all variants, by docs/reproduction/variants.py."""
    return xr.load_dataset(SCATTER.with_name("variants.nc")).astype(float)


def variant_of(variants: xr.Dataset, label: str) -> xr.Dataset:
    """The variant of a row: its choice may have more words after a comma, and so may its value."""

    def short(words: str) -> list[str]:
        return [part.split(",")[0] for part in words.split(": ")]

    (name,) = [name for name in variants["variant"].to_numpy().tolist() if short(name) == short(label)]
    return variants.sel(variant=name)


def test_table_of_the_choices(variants: xr.Dataset, cells: xr.Dataset) -> None:
    """Mean and sd of the reference; change of the mean and ratio of sd on the same seeds, and when it is bold."""
    contents = [0.66, 2.55, 5.0, 9.0]
    reference = variants.sel(variant="reference", content=contents)["vs"].sel(seed=slice(1, 24))
    shipped = cells["vs"].sel(seed=reference["seed"], content=contents)
    np.testing.assert_allclose(reference, shipped, rtol=1e-6)
    _, rows = table_with("choice", "0.66 %", page=SCATTER)
    assert len(rows) == 7
    for row in rows:
        own = variant_of(variants, row[0]).sel(content=contents, seed=slice(1, 24))["vs"]
        for cell, content in zip(row[1:], contents, strict=True):
            check_entry(cell, own.sel(content=content).to_numpy(), reference.sel(content=content).to_numpy(), row[0])


def labels_of(words: str) -> list[str]:
    """Variants of a row with several."""
    choice, values = words.split(": ")
    many = [f"seed {seed}" for seed in range(2, 7)] if values == "five others" else values.split(" and ")
    return [f"{choice}: {value}" for value in many]


def test_table_of_other_samples(variants: xr.Dataset) -> None:
    """Smallest and largest change of mean and sd on the same seeds, and when a ratio is bold."""
    vs = variants["vs"].sel(content=[0.66, 2.55, 5.0, 9.0], seed=slice(1, 24))
    reference = vs.sel(variant="reference")
    header, rows = table_with("choice", "sd, ratio", page=SCATTER)
    assert len(rows) == 7
    names: list[str] = []
    for row in rows:
        means, ratios, distances = [], [], []
        for label in labels_of(row[0]):
            variant = variant_of(variants, label)
            names.append(str(variant["variant"].item()))
            for content in vs["content"]:
                own = vs.sel(variant=variant["variant"], content=content).to_numpy()
                pair = np.stack([own, reference.sel(content=content).to_numpy()])
                pair = pair[:, np.isfinite(pair).all(axis=0)]
                means.append(100 * (pair[0].mean() / pair[1].mean() - 1))
                ratios.append(pair[0].std() / pair[1].std())
                low, high = ratio_interval(pair)
                distances.append(max(low - 1.0, 1.0 - high))  # positive if 1 is outside
        expected = {"mean, change in %": [min(means), max(means)], "sd, ratio": [min(ratios), max(ratios)]}
        check(header, [cell.replace("**", "") for cell in row], expected)
        assert ("**" in row[2]) == (max(distances) > 0) or abs(max(distances)) < 0.03  # of the draw
    starts = "packing: ", "horizontal", "stress", "grading", "size"
    assert sorted(names) == sorted(name for name in vs["variant"].to_numpy().tolist() if name.startswith(starts))


def ratio_interval(pair: Array) -> tuple[float, float]:
    """95 % interval of the ratio of two sd, by bootstrap over the seeds."""
    drawn = pair[:, np.random.default_rng(1).integers(pair.shape[1], size=(20000, pair.shape[1]))]
    deviations = drawn.std(axis=2)
    low, high = np.quantile(np.divide(*deviations[:, deviations[1] > 0]), [0.025, 0.975])
    return float(low), float(high)


def check_entry(cell: str, own: Array, reference: Array, label: str) -> None:
    """One entry of a table of choices."""
    read = re.search(r"\((\d+)/24\)", cell)
    assert np.isfinite(own).sum() == (int(read[1]) if read else 24)
    first, *more = numbers_in(cell.split("(", maxsplit=1)[0].replace("±", " ").replace("**", ""))[:2] or [None]
    if first is None:
        return
    if label == "reference":
        known = own[np.isfinite(own)]
        assert (round(known.mean()), round(deviate(known))) == (first[0], more[0][0])
        return
    pair = np.stack([own, reference])[:, np.isfinite(own) & np.isfinite(reference)]
    assert abs(100 * (pair[0].mean() / pair[1].mean() - 1) - first[0]) <= 0.0501
    assert abs(pair[0].std() / pair[1].std() - more[0][0]) <= 0.00501
    low, high = ratio_interval(pair)
    assert ("**" in cell) == (low > 1.0 or high < 1.0) or min(abs(low - 1.0), abs(high - 1.0)) < 0.03  # of the draw


def test_laws_elsewhere(variants: xr.Dataset) -> None:
    """Errors of the laws of the reference in every variant of the other samples."""
    reference = variants.sel(variant="reference", content=[0.66, 2.55, 5.0, 9.0])
    names = "network_conductance", "path_normalized_connectivity"
    laws = {}
    for name, guess in zip(names, ((3000.0, 0.5, 0.0), (500.0, -1.0, -200.0)), strict=True):
        x, vs = (reference[one].to_numpy().ravel() for one in (name, "vs"))
        known = np.isfinite(vs)
        laws[name], _ = optimize.curve_fit(lambda x, a, b, c: a * x**b + c, x[known], vs[known], p0=guess, maxfev=20000)
    labels = [label for row in table_with("choice", "sd, ratio", page=SCATTER)[1] for label in labels_of(row[0])]
    found = []
    for label in labels:
        own = variant_of(variants, label).sel(content=reference["content"])
        errors = [own["vs"] - (a * own[name] ** b + c) for name, (a, b, c) in laws.items()]
        alone = own["vs"] - reference["vs"].mean("seed")
        found.append([*(float(np.sqrt((one**2).mean())) for one in (*errors, alone)), float(errors[0].mean())])
    conductance, path, mean, bias = np.transpose(found)
    outside = {label: number for number, label in enumerate(labels) if "stress on" in label or "0.05 m" in label}
    assert len(outside) == 3
    inside = [number for number in range(len(labels)) if number not in outside.values()]
    firm, firmer, small = (bias[number] for number in outside.values())
    check_said(
        f"it has rms errors of {conductance[inside].min():.0f} to {conductance[inside].max():.0f} m/s there; the mean "
        f"of the content has {mean[inside].min():.0f} to {mean[inside].max():.0f} m/s",
        f"biased by {firm:+.0f} and {firmer:+.0f} m/s at 50 and 500 kPa",
        f"the bias is {small:+.0f} m/s",
        page=SCATTER,
    )
    low, high = numbers_in(re.findall(r"its rms errors are (\d+ to \d+) m/s", SCATTER.read_text(encoding="utf-8"))[0])
    assert (low[0], high[0]) == pytest.approx((path.min(), path.max()), rel=2e-3)


def test_sentences_on_choices_and_other_samples(
    variants: xr.Dataset, cells: xr.Dataset, published: dict[float, dict[str, float]]
) -> None:
    """What the lists say of both tables, and of the static speed."""
    vs = variants["vs"].sel(content=[0.66, 2.55, 5.0, 9.0], seed=slice(1, 24))
    reference = vs.sel(variant="reference")
    mean, ratio = {}, {}
    for name in vs["variant"].to_numpy().tolist():
        both = reference.notnull() & vs.sel(variant=name).notnull()
        own, other = (one.where(both) for one in (vs.sel(variant=name), reference))
        mean[name] = 100.0 * (own.mean("seed") / other.mean("seed") - 1.0).to_numpy()
        ratio[name] = (own.std("seed") / other.std("seed")).to_numpy()
    shares = []
    names = ["reference", *(f"packing: seed {seed}" for seed in range(2, 7))]
    for content in vs["content"]:
        table = vs.sel(content=content, variant=names)
        parts = variance_parts(table.dropna("seed").to_numpy())
        shares.append((max(0.0, parts.first) / parts.total, parts.second / parts.total))
    packing, cement = np.transpose(shares)
    firm, firmer = (1.0 + mean[f"stress on the lid: {stress} kPa"] / 100.0 for stress in (50, 500))
    small = vs.sel(variant="size, bands and damped layers with it: 0.05 m x 0.15 m")
    single = ratio["as printed: single P contacts"][:3]
    stiff = cells["static_speed"].sel(content=list(published))
    target = printed_column(published, "standard_deviation") / printed_column(published, "mean")
    static = (stiff.std("seed", ddof=1) / stiff.mean("seed")).to_numpy() / target
    low = np.array(list(published)) <= 6.0
    check_said(
        f"the packing causes {100 * packing.max():.0f} % of the variance at most",
        f"the cement alone {100 * cement.min():.0f} to {100 * cement.max():.0f} %",
        f"raises Vs by {firm[0]:.2f} and {firmer[0] / firm[0]:.2f} at 0.66 %",
        f"only {100 * firm[-1] - 100:.0f} and {100 * firmer[-1] / firm[-1] - 100:.0f} % at 9 %",
        f"{int(small.notnull().sum())} of {small.size} samples have a velocity",
        f"single contacts have {single.min():.2f} to {single.max():.2f} of it up to 5 %",
        f"scatters by {static[low].min():.1f} to {static[low].max():.1f} of the printed values up to 6 %, and by "
        f"{static[-2:].mean():.1f} of them at 8 and 9 %",
        page=SCATTER,
    )


def test_two_packings_that_took_no_part(variants: xr.Dataset, published: dict[float, dict[str, float]]) -> None:
    """Their means and scatter beside Table 3."""
    contents = list(published)
    off, scatter = [], []
    for name in ("p31415", "p27182"):
        vs = variants["vs"].sel(variant=name, content=contents)
        mean, deviation = vs.mean("seed").to_numpy(), vs.std("seed", ddof=1).to_numpy()
        off.append(mean / printed_column(published, "mean") - 1)
        target = printed_column(published, "standard_deviation") / printed_column(published, "mean")
        scatter.append(deviation / mean / target)
    inside = np.sort(np.ravel(scatter))
    check_said(
        f"means within {100 * np.abs(off).max():.1f} % of the paper's",
        f"mean {inside[inside >= 0.75].min():.2f} to {inside[inside <= 1.6].max():.2f} of it at 31 of 32 contents",
        page=SCATTER,
    )


def deviate(values: Array) -> float:
    """Standard deviation of a sample."""
    return float(values.std(ddof=1))


def fourth_moment(values: Array) -> float:
    """Kurtosis, 3 of a normal distribution."""
    return float(stats.kurtosis(values, fisher=False))


def test_sentences_on_shape(cells: xr.Dataset, published: dict[float, dict[str, float]]) -> None:
    """Outcomes of the test, and its power."""
    agree = sum(
        (stats.jarque_bera(values_at(cells, content)).pvalue >= 0.05) == row["normal"]
        for content, row in published.items()
    )
    gamma = np.random.default_rng(1).gamma(16.0, size=(10000, 116))
    power = 100 * np.mean(stats.jarque_bera(gamma, axis=1).pvalue < 0.05)
    assert power == pytest.approx(38, abs=2)
    assert agree == 12
    check_said("Twelve of 16 outcomes are the printed ones", "a skewness of 0.5 in 38 % of cases")


def standardised(values: Array, known: NDArray[np.bool_]) -> Array:
    """Values of the known samples less the mean of their content and over its deviation; 0 where nothing varies."""
    found = np.zeros(values.shape)
    for column in range(values.shape[1]):
        mine = values[known[:, column], column]
        if np.ptp(mine) > 1e-9 * np.abs(mine).max():
            found[known[:, column], column] = (mine - mine.mean()) / mine.std()
    return found[known]


def ranked(values: Array, known: NDArray[np.bool_]) -> Array:
    """Ranks of the known samples within their content."""
    found = np.zeros(values.shape)
    for column in range(values.shape[1]):
        found[known[:, column], column] = stats.rankdata(values[known[:, column], column])
    return found


@pytest.mark.full
def test_correlations_of_the_page(cells: xr.Dataset) -> None:
    """Coefficients over all contents and within one; the sample without cement counts once."""
    vs = cells["vs"].to_numpy()
    known = np.isfinite(vs) & ((cells["content"].to_numpy() > 0) | (np.arange(len(vs)) == 0)[:, None])
    header, rows = table_with("feature")
    p = [
        [stats.spearmanr(x[known[:, c], c], vs[known[:, c], c]).pvalue for c in range(1, vs.shape[1])]
        for x in (cells[name].to_numpy().astype(float) for name in FEATURES.values())
    ]
    significant = stats.false_discovery_control(np.ravel(p)).reshape(np.shape(p)) < 0.05
    for row in rows:
        x = cells[FEATURES[row[0]]].to_numpy().astype(float)
        count = significant[list(FEATURES).index(row[0])].sum()
        coefficient: Callable[[Array, Array], float] = lambda a, b: float(np.corrcoef(a, b)[0, 1])  # noqa: E731 - short
        check(
            header,
            row,
            {
                "Pearson": [coefficient(x[known], vs[known])],
                "Spearman": [float(stats.spearmanr(x[known], vs[known]).statistic)],
                "within: Spearman": [
                    coefficient(standardised(ranked(x, known), known), standardised(ranked(vs, known), known))
                ],
                "contents of 16": [count],
            },
        )


def law_errors(
    x: Array, y: Array, seeds: Array, guess: tuple[float, float, float] = (500.0, -1.0, -200.0)
) -> tuple[Array, Array]:
    """Parameters of a x^b + c by least squares, and errors of each seed from a fit to the others."""

    def law(x: Array, a: float, b: float, c: float) -> Array:
        return a * x**b + c

    start, _ = optimize.curve_fit(law, x, y, p0=guess, maxfev=20000)
    errors = np.empty(y.size)
    for seed in np.unique(seeds):
        out = seeds == seed
        fit, _ = optimize.curve_fit(law, x[~out], y[~out], p0=start, maxfev=20000)
        errors[out] = y[out] - law(x[out], *fit)
    return start, errors


@pytest.mark.full
def test_laws_of_the_page(database: Path) -> None:
    """C_d,n by Dijkstra for the weights of each law, their fits and errors; the conductance by another solver."""
    with open_campaign(database) as campaign:
        packing, half = campaign.packing(), campaign.config["wave"]["receiver_half_width"]
        sending, thickness = (
            campaign.config["wave"][name] for name in ("transmitter_half_width", "boundary_thickness")
        )
        found = [(c.key.seed, c.key.content, c.vs, c.cement) for c in campaign.select(with_arrays=True)]
    samples = [sample for sample in found if sample[1] > 0 or sample[0] == 1]  # one without cement
    assert all(cement is not None for *_, cement in samples)
    centres, radius, count = np.column_stack([packing.x, packing.y]), packing.radius, packing.radius.size
    pairs = spatial.cKDTree(centres).query_pairs(2 * radius.max(), output_type="ndarray")
    pairs = np.sort(pairs, axis=1)
    touching = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1) < radius[pairs].sum(axis=1)
    pairs = pairs[touching]
    keys = pairs[:, 0] * count + pairs[:, 1]
    middle = np.abs(packing.y - packing.height / 2)
    left = np.flatnonzero((packing.x < radius) & (middle < sending))
    right = np.flatnonzero((packing.width - packing.x < radius) & (middle < half))
    straight = packing.width / (2 * np.median(radius)) - 1
    bonded = np.array([np.isin(keys, np.sort(c.contacts, axis=1) @ [count, 1]) for *_, c in samples])

    def c_dn(hertz: float, bond: float) -> Array:
        first = np.concatenate([pairs[:, 0], np.full(left.size, count)])
        second = np.concatenate([pairs[:, 1], left])
        found = []
        for mask in bonded:
            # A start before the transmitter; a tiny length, since a sparse matrix has no edge of length 0.
            weights = np.concatenate([np.where(mask, bond, hertz), np.full(left.size, 1e-12)])
            graph = sparse.csr_array((weights, (first, second)), shape=(count + 1, count + 1))
            found.append(sparse.csgraph.dijkstra(graph, directed=False, indices=count)[right].min())
        return np.asarray((np.array(found) - bond * straight) / ((hertz - bond) * straight))

    assert len(samples) == 116 * 16 + 1
    seeds, contents = np.array([sample[:2] for sample in samples]).T
    vs = np.array([np.nan if sample[2] is None else sample[2] for sample in samples])
    known = np.isfinite(vs)
    coordination = 2 * len(pairs) / count
    weights = (coordination ** (-2 / 3), 1 / coordination), (1.0, 0.83), (1.0, 0.87)
    fits: list[Array] = []
    mean_errors: list[float] = []
    for hertz, bond in weights:  # by physical meaning, of the paper's ratio, and of the best one
        law, errors = law_errors(c_dn(hertz, bond)[known], vs[known], seeds[known])
        if not fits:
            check_bias(errors, contents[known])
        fits.append(law)
        mean_errors.append(float(np.sqrt(np.mean(errors**2))))
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    ours = re.findall(r"(\d+) C_d,n\^(\S+) ([+-]\d+) m/s", text)
    assert len(ours) == 2
    for printed, law in zip(ours, fits, strict=False):
        assert [float(part) for part in printed] == pytest.approx(list(law), rel=0.02, abs=1.0)
    theirs = re.findall(r"published: (\d+) C_d,n\^(\S+) ([+-]\d+)\)", text)
    for printed, row in zip(theirs, published_study().laws, strict=True):
        assert [float(part) for part in printed] == [row.a, row.conclusions_b, row.c]
    alone = calcidem.load_paper_campaign()["vs"].sel(content=slice(0.1, None))
    size = alone.notnull().sum("seed")
    apart = (alone - alone.mean("seed")) * size / (size - 1.0)
    check_said(
        f"on unseen seeds are {min(mean_errors):.0f} to {max(mean_errors):.0f} m/s, that of the mean of the content is "
        f"{float(np.sqrt((apart**2).mean())):.0f} m/s"
    )
    check_conductance(packing, pairs, bonded, seeds, contents, packing.height - 2 * float(thickness))


def check_conductance(
    packing: PackingRecord,
    pairs: NDArray[np.int64],
    bonded: NDArray[np.bool_],
    seeds: Array,
    contents: Array,
    strip: float,
) -> None:
    """The stored G of 40 samples is that of another solver."""
    stored = calcidem.load_paper_campaign()["network_conductance"]
    for sample in np.linspace(0, len(seeds) - 1, 40).astype(int).tolist():
        found = stored.sel(seed=seeds[sample], content=contents[sample])
        assert float(found) == pytest.approx(conductance(packing, pairs, bonded[sample], strip), rel=1e-5)


def conductance(packing: PackingRecord, pairs: NDArray[np.int64], bonded: NDArray[np.bool_], strip: float) -> float:
    """G by conjugate gradients: current between the side walls over that if all is cemented."""
    across = (packing.y[pairs].mean(axis=1) - packing.height / 2) / strip
    energy = np.where(np.abs(across) < 0.5, np.cos(np.pi * across) ** 2, 0.0)
    high, low = packing.width - packing.x < packing.radius, packing.x < packing.radius
    currents = []
    for kinds in (bonded, np.ones(len(pairs), dtype=bool)):
        weight = np.where(kinds, 1.0, 0.01) * energy
        graph = sparse.csr_array((weight, pairs.T), shape=(packing.radius.size,) * 2)
        laplace = sparse.csgraph.laplacian(graph + graph.T).tocsr()
        free = ~high & ~low & (laplace.diagonal() > 0)
        inside = laplace[free][:, free]
        scale = sparse.diags_array(1 / inside.diagonal())
        potential = high.astype(float)
        potential[free], failed = sparse.linalg.cg(inside, -(laplace @ potential)[free], rtol=1e-10, M=scale)
        assert not failed
        currents.append(potential @ laplace @ potential)
    return float(currents[0] / currents[1])


SYMBOLS = FEATURES | {
    "G": "network_conductance",
    "S": "network_cemented_share",
    "S_f": "network_strong_share",
    "Z_b": "network_coordination_number",
    "A_b": "network_anisotropy",
    "K": "network_components",
    "K_max": "network_largest_component",
    "N_gap": "network_gap_contacts",
    "static_speed": "static_speed",
}


def mean_rank_correlation(x: Array, y: Array) -> float:
    """Mean over contents of Spearman's coefficient within a content."""
    known = np.isfinite(x) & np.isfinite(y)
    columns = [column for column in range(x.shape[1]) if np.ptp(x[known[:, column], column]) > 0]
    return float(np.mean([stats.spearmanr(*(z[known[:, c], c] for z in (x, y))).statistic for c in columns]))


def test_correlations_of_the_conductance_page(variants: xr.Dataset) -> None:
    """Mean rank correlations within a content of the shipped campaign, and of another packing."""
    other = variants.sel(variant="p27182", content=slice(0.1, None))
    cells = calcidem.load_paper_campaign().sel(content=slice(0.1, None))
    low = cells["content"].to_numpy() <= 0.66
    header, rows = table_with("1: Vs", page=CONDUCTANCE)
    vs, effective = (cells[name].to_numpy() for name in ("vs", "effective_vs"))
    for row in rows:
        x = cells[SYMBOLS[row[0]]].to_numpy().astype(float)
        expected = {
            "1: Vs": [mean_rank_correlation(x, vs)],
            "up to 0.66 %": [mean_rank_correlation(x[:, low], vs[:, low])],
            "above": [mean_rank_correlation(x[:, ~low], vs[:, ~low])],
        }
        check(header, row, expected)
        assert float(row[4]) == pytest.approx(mean_rank_correlation(x, effective), abs=0.006)
        if row[5]:  # not the static speed
            x, *two = (other[name].to_numpy() for name in (SYMBOLS[row[0]], "vs", "effective_vs"))
            found = [mean_rank_correlation(x, y) for y in two]
            assert [float(cell) for cell in row[5:]] == pytest.approx(found, abs=0.006)


@pytest.mark.full
def test_laws_and_predictions_of_the_conductance_page(variants: xr.Dataset) -> None:
    """Fits and their errors on seeds left out and on other packings; samples predicted from others of their content."""
    cells = calcidem.load_paper_campaign().sel(content=slice(0.1, None))
    vs = cells["vs"].to_numpy()
    known = np.isfinite(vs)
    seeds, contents = (
        np.broadcast_to(one, vs.shape)[known]
        for one in (cells["seed"].to_numpy()[:, None], cells["content"].to_numpy())
    )
    header, rows = table_with("Vs from", page=CONDUCTANCE)
    for row, guess in zip(rows, ((3000.0, 0.5, 0.0), (500.0, -1.0, -200.0)), strict=False):
        x = cells[SYMBOLS[row[0]]].to_numpy()[known]
        (a, b, c), errors = law_errors(x, vs[known], seeds, guess)
        check(header, row, {"rms error on unseen seeds, m/s": [float(np.sqrt(np.mean(errors**2)))]})
        law = re.fullmatch(r"([\d.]+) \S+\^(\S+) ([+-]\d+)", row[header.index("law")])
        assert law is not None
        assert [float(part) for part in law.groups()] == pytest.approx([a, b, c], rel=0.01, abs=1.0)
        for cell, name in zip(row[3:], ("p31415", "p27182"), strict=True):
            other = variants.sel(variant=name, content=slice(0.1, None))
            error = other["vs"] - (a * other[SYMBOLS[row[0]]] ** b + c)
            assert float(np.sqrt((error**2).mean())) == pytest.approx(float(cell), abs=0.51 + 1e-3 * float(cell))
    count, mean = cells["vs"].notnull().sum("seed"), cells["vs"].mean("seed")
    packings = [variants["vs"].sel(variant=name, content=cells["content"]) for name in ("p31415", "p27182")]
    apart = [(cells["vs"] - mean) * count / (count - 1.0), *(vs - mean for vs in packings)]
    found = [float(np.sqrt((one**2).mean())) for one in apart]
    assert [float(cell) for cell in rows[-1][2:]] == pytest.approx(found, abs=0.501)
    names = {name: cells[variable].to_numpy() for name, variable in SYMBOLS.items()}
    names["log G"] = np.log(names["G"])
    check_predictors({name: values[known] for name, values in names.items()}, vs[known], contents)


@pytest.mark.full
def test_the_conductance_of_sand_matters_little(database: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sand contacts that conduct a third, or ten times as much, give the correlations of the page."""
    found = []
    with calcidem.open_campaign(database) as campaign:
        vs = campaign.vs().sel(content=slice(0.1, None))
        analysis = campaign.analyse()
        for sand in (0.003, 0.005, 0.01, 0.03, 0.1):
            monkeypatch.setattr(packing_graph, "_SAND", sand)
            conductance = xr.full_like(vs, np.nan)
            for sample in analysis.samples:
                if sample.content > 0.0:
                    current = analysis.graphs[0]._current(sample.kinds > 0)
                    conductance.loc[sample.seed, sample.content] = current
            found.append(mean_rank_correlation(conductance.to_numpy(), vs.to_numpy()))
    check_said(f"within a content is {min(found):.2f} to {max(found):.2f}, so k was not fitted", page=CONDUCTANCE)


@pytest.mark.full
def test_features_that_are_left_out_explain_little(database: Path, cells: xr.Dataset) -> None:
    """Neither those that are not stored nor the others that are left out exceed the coefficients of the page."""
    programs = runpy.run_path(str(SCATTER.with_name("features.py")))
    found = [abs(within) for _, within in programs["left_out_correlations"](str(database)).values()]
    shown = {SYMBOLS[row[0]] for row in table_with("1: Vs", page=CONDUCTANCE)[1]}
    vs = cells["vs"].to_numpy()[:, 1:]
    others = [
        mean_rank_correlation(cells[name].to_numpy()[:, 1:], vs)
        for name in {*SYMBOLS.values()} - shown - {"path_connectivity"}
    ]
    check_said(
        f"have at most {np.abs(others).max():.2f} with Vs. Features that are not stored, such as the minimum cut of "
        f"the bonds, have at most {max(found):.2f}",
        page=CONDUCTANCE,
    )


def check_predictors(features: dict[str, Array], vs: Array, contents: Array) -> None:
    """The page has the scores of four sets of features, and the hits of the one that is used."""
    scores: dict[str, float] = {}
    hits: dict[str, float] = {}
    for name in ("log G", "C_d,n", "", "static_speed"):
        x = np.array([features[name]] if name else []).reshape(-1, vs.size).T
        whole = np.isfinite(x).all(axis=1)
        hits[name], scores[name] = pooled(x[whole], vs[whole], contents[whole])
    check_said(
        f"{100 * hits['log G']:.1f} % of the velocities are within its 95 % intervals",
        f"{scores['log G']:.1f} m/s with log G, {scores['C_d,n']:.1f} m/s with C_d,n and {scores['']:.1f} m/s with the "
        f"content alone. The static speed gives {scores['static_speed']:.1f} m/s",
        page=CONDUCTANCE,
    )


def check_bias(errors: Array, contents: Array) -> None:
    """The page has the mean errors of the law by physical meaning at two contents."""
    bias = [errors[contents == content].mean() for content in (3.17, 9.0)]
    check_said(f"by {bias[0]:+.0f} m/s at 3.17 % and by {bias[1]:+.0f} m/s at 9 %")


def pooled(x: Array, vs: Array, contents: Array) -> tuple[float, float]:
    """Share inside the interval and mean interval score (m/s) over all contents with cement."""
    hits, scores = zip(
        *(left_out(x[contents == one], vs[contents == one]) for one in set(contents) - {0.0}), strict=True
    )
    return float(np.mean(np.concatenate(hits))), float(np.mean(np.concatenate(scores)))


def left_out(x: Array, vs: Array) -> tuple[list[bool], list[float]]:
    """Whether each sample, predicted from the others, is inside its interval, and its interval score (m/s)."""
    design, y = np.column_stack([np.ones(len(vs)), x]), np.log(vs)
    hits: list[bool] = []
    scores: list[float] = []
    for out in range(len(y)):
        others = np.arange(len(y)) != out
        solution, *_ = np.linalg.lstsq(design[others], y[others], rcond=None)
        hat = design[others] @ np.linalg.pinv(design[others])
        errors = (y[others] - design[others] @ solution) / (1 - np.diag(hat))
        low, high = np.exp(design[out] @ solution + np.quantile(errors, [0.025, 0.975], method="weibull"))
        hits.append(bool(low <= vs[out] <= high))
        scores.append(high - low + 40 * max(0.0, low - vs[out], vs[out] - high))
    return hits, scores


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """Give a database of the shipped campaign, with its packing."""
    from calcidem.app.cli.exchange import import_command  # noqa: PLC0415 - of this test alone

    path = resources.files("calcidem.app.config.presets").joinpath("paper.nc")
    target = tmp_path / "paper.db"
    import_command(Path(str(path)), str(target))
    return target
