"""The report in a real browser: complete, quiet, as wide as the screen, and all that one can click, type or hover."""

import math
import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from chromium import Chromium

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.report.page import write_report
from calcidem.ends import CellStatus
from calcidem.storage.records import CampaignRecord, CellKey, CellResult, canonical_hash
from calcidem.storage.sql.store import Store

pytestmark = pytest.mark.full

LARGE_SEEDS, LARGE_CONTENTS = 1000, 100
MIB = 1 << 20


@pytest.fixture
def page(browser: Chromium, small_report: Path) -> Iterator[Chromium]:
    """Give the browser with the report of the small campaign; afterwards its console has to be empty."""
    browser.complaints.clear()
    browser.requests.clear()
    browser.show(small_report, 1280)
    yield browser
    assert browser.complaints == []
    assert set(browser.requests) <= {small_report.as_uri(), "about:blank"}


def point_of(page: Chromium, seed: int, content: float) -> tuple[float, float]:
    """Give the middle of a cell of the map in the window: its axes are 60 and 42 pixels, a cell is 24 high."""
    page.evaluate("document.getElementById('map').scrollIntoView({block: 'center'})")
    left, top, width = page.evaluate(
        "(() => { const b = document.getElementById('map').getBoundingClientRect(); return [b.x, b.y, b.width] })()"
    )
    cell = min(max((width - 68) / 6, 8), 44)
    row = (0.0, 0.34, 0.66, 2.55, 5.0, 9.0).index(content)
    return left + 60 + (seed - 0.5) * cell, top + 8 + (5.5 - row) * 24


def measured_cell(database: Path) -> CellResult:
    """Give a cell with cement that has a velocity: neither the first nor the last seed."""
    with open_campaign(database) as campaign:
        return next(campaign.select(seed=(2, 3, 4, 5), content=(0.66, 2.55), status="done"))


def rows(page: Chromium) -> list[list[str]]:
    """Give the cells of the table as text."""
    found: list[list[str]] = page.evaluate(
        "[...document.querySelectorAll('#cells tbody tr')].map(r => [...r.cells].map(c => c.textContent))"
    )
    return found


def choose(page: Chromium, element: str, value: str) -> None:
    """Set a filter as a user does."""
    page.evaluate(
        f"(() => {{ const e = document.getElementById('{element}'); e.value = '{value}';"
        "e.dispatchEvent(new Event('input', {bubbles: true})) })()"
    )


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1280])
def test_page_is_complete_and_fits(page: Chromium, small_report: Path, width: int, dark: bool) -> None:
    """Every picture loads and has a text, nothing is wider than the screen, no text is tiny, and a cell can be read."""
    page.show(small_report, width, dark=dark, anchor="#seed=1&content=0.66")
    page.wait_for("document.querySelector('#signal svg') && document.querySelector('#sample canvas').width > 300")
    seen = page.evaluate(
        """({
        pictures: document.images.length,
        broken: [...document.images].filter(p => !p.complete || !p.naturalWidth || p.alt.length < 20).length,
        page: document.documentElement.scrollWidth,
        small: [...document.querySelectorAll("td, th, p, figcaption, dd, text, label")]
          .filter(e => parseFloat(getComputedStyle(e).fontSize) < 12).length,
        unnamed: [...document.querySelectorAll("button, select, input, canvas[role]")]
          .filter(e => !e.hidden && !e.textContent && !e.labels?.length && !e.ariaLabel).length,
        dark: getComputedStyle(document.body).backgroundColor,
        })"""
    )
    assert seen["pictures"] > 8
    assert (seen["broken"], seen["small"], seen["unnamed"]) == (0, 0, 0)
    assert seen["page"] <= width
    assert (brightness(seen["dark"]) < 0.1) == dark


@pytest.mark.parametrize("width", [390, 1280])
def test_what_goes_on_beyond_an_edge_is_marked_there(page: Chromium, small_report: Path, width: int) -> None:
    """On a narrow screen pictures, map and tables scroll; a mark at the edge says so, and goes at the end."""
    page.show(small_report, width)
    boxes = "[...document.querySelectorAll('.ends > *')]"
    page.evaluate("document.querySelectorAll('details').forEach(one => (one.open = true))")
    page.wait_for(f"{boxes}.every(b => b.parentElement.matches('.goes-right') === (b.scrollWidth > b.clientWidth + 1))")
    assert (page.evaluate("document.querySelectorAll('figure .ends.goes-right img').length") > 5) == (width == 390)
    page.evaluate(f"{boxes}.forEach(b => (b.scrollLeft = 1e6))")
    page.wait_for("!document.querySelector('.goes-right')")
    assert (page.evaluate("document.querySelectorAll('figure .ends.goes-left img').length") > 5) == (width == 390)


def brightness(colour: str) -> float:
    """Relative luminance of a colour like rgb(1, 2, 3), as WCAG 2.2 defines it."""
    shares = [int(part) / 255 for part in re.findall(r"\d+", colour)[:3]]
    linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_texts_stand_out_and_the_switch_changes_colours(page: Chromium) -> None:
    """In both themes, which the switch changes, every colour of a text has a contrast of 4.5 or more (WCAG AA)."""
    backgrounds = set()
    for _ in range(2):
        colours = page.evaluate(
            """Object.fromEntries(["ink", "quiet", "accent", "paper", "wash", "mark"].map(name => {
            const e = document.body.appendChild(document.createElement("i"));
            e.style.color = `var(--${name})`;
            return [name, getComputedStyle(e).color];
            }))"""
        )
        bright = {name: brightness(colour) for name, colour in colours.items()}
        backgrounds.add(colours["paper"])
        for text, ground in (("ink", "paper"), ("ink", "wash"), ("ink", "mark"), ("quiet", "paper"), ("quiet", "wash")):
            low, high = sorted((bright[text], bright[ground]))
            assert (high + 0.05) / (low + 0.05) >= 4.5, (text, ground)
        low, high = sorted((bright["accent"], bright["wash"]))
        assert (high + 0.05) / (low + 0.05) >= 4.5
        page.click_on("#theme")
    assert len(backgrounds) == 2


def test_a_click_on_the_map_opens_the_cell(page: Chromium, small_database: Path) -> None:
    """A cell's place on the map leads to its velocity, signals, sample and record; the way back closes nothing."""
    cell = measured_cell(small_database)
    seed, content = cell.key.seed, cell.key.content
    assert cell.vs is not None
    page.click(*point_of(page, seed, content))
    page.wait_for("document.getElementById('record')")
    assert page.evaluate("location.hash") == f"#seed={seed}&content={content:g}"
    heading = page.evaluate("document.querySelector('#cell h3').textContent")
    assert heading == f"Seed {seed} at {content:g} %: Vs = {cell.vs:.4g} m/s"

    assert "time (ms)" in page.evaluate("document.querySelector('#signal svg').textContent")
    said = page.evaluate("document.querySelector('#sample canvas').ariaLabel")
    assert f"{cell.p_contacts} P contacts, {cell.c_contacts} C contacts" in said
    assert "path of" in said
    record = page.evaluate("document.getElementById('record').textContent")
    assert f"number of time steps{cell.steps}" in re.sub(r"\s", " ", record).replace("  ", "")
    page.click_on("#cell nav a")
    page.wait_for("document.querySelector('#cell h3').textContent.startsWith('Seed " + f"{seed - 1} at ')")


def test_the_map_can_be_walked_with_keys(page: Chromium) -> None:
    """Arrow keys move from the first cell, values are said, Enter opens, and the focus follows."""
    page.evaluate("document.getElementById('map').focus()")
    for key in ("ArrowRight", "ArrowUp", "ArrowUp"):
        page.press(key)
    assert page.evaluate("document.getElementById('tip').textContent").startswith("seed 2 at 0.66 %\nVs ")
    page.press("Enter")
    page.wait_for("document.querySelector('#cell h3')?.textContent.startsWith('Seed 2 at 0.66 %')")
    page.wait_for("document.activeElement.id === 'cell'")


def test_values_show_under_the_pointer(page: Chromium, small_database: Path) -> None:
    """The pointer over a cell shows its velocity, over a failed one the reason, over a signal its values."""
    cell = measured_cell(small_database)
    seed, content = cell.key.seed, cell.key.content
    x, y = point_of(page, seed, content)
    page.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    assert (
        page.evaluate("document.getElementById('tip').textContent")
        == f"seed {seed} at {content:g} %\nVs {cell.vs:.4g} m/s"
    )
    x, y = point_of(page, 6, 9.0)
    page.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    assert "failed: the worker ran out of memory" in page.evaluate("document.getElementById('tip').textContent")
    page.evaluate(f"location.hash = '#seed={seed}&content={content:g}'")
    page.wait_for("document.querySelector('#signal svg')")
    page.evaluate("document.querySelector('#signal').scrollIntoView({block: 'center'})")
    box = page.evaluate("(b => [b.x, b.y, b.width])(document.querySelector('#signal svg').getBoundingClientRect())")
    page.send("Input.dispatchMouseEvent", type="mouseMoved", x=box[0] + box[2] / 2, y=box[1] + 60)
    assert re.fullmatch(
        r"[\d.]+ ms: transmitted .* m/s, received .* m/s",
        page.evaluate("document.getElementById('reading').textContent"),
    )


def test_filters_choose_and_headings_sort(page: Chromium, small_database: Path) -> None:
    """Filters leave the cells asked for, headings sort both ways, what is missing comes last, a button shows all."""
    assert page.evaluate("document.getElementById('count').textContent").startswith("36 of 36 cells")
    choose(page, "content", "5")
    choose(page, "seeds", "1 - 3, 5-5")
    assert [row[:2] for row in rows(page)] == [["1", "5"], ["2", "5"], ["3", "5"], ["5", "5"]]
    page.click_on("#filters button")
    page.wait_for("document.getElementById('count').textContent.startsWith('36 of 36')")
    choose(page, "outcome", "failed")
    assert [row[:3] for row in rows(page)] == [["6", "9", "failed"]]
    page.click_on("#filters button")
    page.wait_for("document.getElementById('count').textContent.startsWith('36 of 36')")
    with open_campaign(small_database) as campaign:
        known = sorted(float(vs) for vs in campaign.vs().to_numpy().ravel() if math.isfinite(vs))
    for order, wanted in (("ascending", known), ("descending", known[::-1])):
        page.click_on("[data-sort=vs]")
        assert page.evaluate("document.querySelector('[data-sort=vs]').parentElement.ariaSort") == order
        assert [row[3] for row in rows(page)[:3]] == [f"{vs:.4g}" for vs in wanted[:3]]
    page.click_on("#on")
    assert rows(page)[-1][3] == "\N{EN DASH}"
    choose(page, "least", str(known[-1] * (1.0 - 1e-5)))  # the page keeps six digits
    assert [row[3] for row in rows(page)] == [f"{known[-1]:.4g}"]


def test_a_cell_without_velocity_says_why(page: Chromium) -> None:
    """A failed cell has its reason in its details, no signal, and what is stored of it."""
    page.evaluate("location.hash = '#seed=6&content=9'")
    page.wait_for("document.querySelector('#cell h3')?.textContent === 'Seed 6 at 9 %: failed'")
    text = page.evaluate("document.getElementById('cell').textContent")
    assert "the worker ran out of memory" in text
    assert "No signal is stored." in text


def test_colours_show_another_quantity(page: Chromium) -> None:
    """The map takes the colours of any quantity, says which, and has a scale with its unit."""
    before = page.evaluate("document.getElementById('map').toDataURL()")
    choose(page, "colour", "vs_error")
    assert "relative standard error of vs by reading, simulation and pulse" in page.evaluate(
        "document.getElementById('map').ariaLabel"
    )
    assert "relative standard error of vs by reading, simulation and pulse" in page.evaluate(
        "document.getElementById('scale').textContent"
    )
    assert page.evaluate("document.getElementById('map').toDataURL()") != before
    choose(page, "colour", "status")
    assert set(page.evaluate("[...document.querySelectorAll('#scale > span')].map(e => e.textContent)")) >= {
        "done",
        "failed",
    }


def test_a_hundred_thousand_cells_make_a_page(browser: Chromium, tmp_path: Path) -> None:
    """The page of 100,000 cells is below 6 MiB, says what it leaves out, and its map and table answer."""
    database = tmp_path / "large.db"
    seeds, contents = tuple(range(LARGE_SEEDS)), tuple(place / 10 for place in range(LARGE_CONTENTS))
    numerics = {"frequency": 8e3, "time_step": 1e-7, "stability_limit": 1.2e-7, "steps": 3000}
    draw = np.random.default_rng(1).uniform  # numbers that cannot be compressed
    with Store(database) as store:
        store.begin_campaign(CampaignRecord(canonical_hash({}), "large", "{}", contents, seeds, datetime.now(UTC)))
        for seed in seeds:
            store.record_results(
                CellResult(
                    CellKey(seed, content),
                    CellStatus.DONE,
                    vs=1000 + content + draw(0, 0.01),
                    numerical_error=draw(0, 0.05),
                    pulse_effect=draw(0, 0.03),
                    reading_error=draw(0, 0.05),
                    seconds=draw(0, 1),
                    **numerics,
                )
                for content in contents
            )
    with closing(sqlite3.connect(database)) as connection:
        assert connection.execute("select count(*) from result").fetchone() == (LARGE_SEEDS * LARGE_CONTENTS,)
    report = write_report(database, tmp_path / "large.html")
    assert report.stat().st_size < 6 * MIB
    browser.complaints.clear()
    browser.show(report, 1280)
    assert "only 6 quantities are in this page" in browser.evaluate("document.getElementById('explore').textContent")
    choose(browser, "seeds", "990-999")
    assert browser.evaluate("document.getElementById('count').textContent").startswith("1,000 of 100,000 cells")
    browser.evaluate("document.getElementById('viewport').scrollLeft = 1e6")
    browser.evaluate("location.hash = '#seed=999&content=9.9'")
    browser.wait_for("document.querySelector('#cell h3')?.textContent.startsWith('Seed 999 at 9.9 %: Vs = 1010 m/s')")
    assert browser.complaints == []
