"""The live page in a real browser: it grows while a run computes, opens cells, and can be read by everyone."""

import json
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from chromium import Chromium
from live_page import ADDRESS, Live, serve
from places import TUTORIAL

from calcidem.app.campaign.opened import open_campaign
from calcidem.ends import CellStatus
from calcidem.storage.records import CellResult
from calcidem.storage.sql.store import Store

if TYPE_CHECKING:
    from conftest import Workshop

pytestmark = pytest.mark.full

HOSTILE = "<img src=x onerror=\"document.title='hacked'\"><script>document.title='hacked'</script>"
SETTLED = "document.querySelectorAll('.campaign').length === 2 && document.querySelector('#cells tbody tr')"


@pytest.fixture(scope="module")
def live(small_database: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    """Give a server of two campaigns, one of which has a cell with a hostile reason."""
    folder = tmp_path_factory.mktemp("live")
    small, quick = folder / "small.db", folder / "quick.db"
    shutil.copy(small_database, small)
    shutil.copy(TUTORIAL, quick)
    with Store(small) as store:
        store.use_campaign()
        store.record_results([CellResult(store.pending()[0], CellStatus.FAILED, HOSTILE)])
    with serve(small, quick) as running:
        yield running


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Give the source of axe-core, as npm has it."""
    folder = tmp_path_factory.mktemp("axe")
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed (Debian: apt-get install npm)")
    command = ["npm", "install", "--prefix", str(folder), "--no-audit", "--no-fund", "axe-core@4"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    if done.returncode:
        pytest.skip(f"axe-core cannot be installed: {done.stderr[-200:]}")
    return (folder / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")


def measured(database: Path) -> CellResult:
    """Give a cell with a velocity, cement and a section."""
    with open_campaign(database) as campaign:
        return next(campaign.select(seed=(2, 3, 4, 5), content=(0.66, 2.55), status="done"))


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1280])
def test_page_fits_and_is_accessible(browser: Chromium, live: Live, axe: str, width: int, dark: bool) -> None:
    """With an open cell nothing is wider than the screen, axe-core finds nothing, and hostile text is only text."""
    cell = measured(live.databases[0])
    browser.complaints.clear()
    browser.requests.clear()
    browser.visit(live.url, width, dark=dark)
    browser.wait_for(SETTLED)
    browser.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")
    browser.evaluate(f"location.hash = '#seed={cell.key.seed}&content={cell.key.content:g}'")
    browser.wait_for("document.querySelector('#signal svg') && document.querySelector('#section svg')")
    assert "onerror" in browser.evaluate("document.querySelector('.campaign details').textContent")
    assert browser.evaluate("document.title") == "calcidem, live"
    assert browser.evaluate("document.querySelectorAll('img[src=x]').length") == 0
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    browser.evaluate(axe)
    found = json.loads(browser.evaluate("axe.run().then(found => JSON.stringify(found))"))
    assert [(one["id"], [node["html"][:200] for node in one["nodes"]]) for one in found["violations"]] == []
    assert len(found["passes"]) > 20
    assert browser.complaints == []
    assert {url.partition("?")[0].rpartition(":")[0] for url in browser.requests} <= {"http://127.0.0.1", "about"}


def test_keys_reach_everything(browser: Chromium, live: Live) -> None:
    """The Tab key leads to the buttons of both campaigns and to the map, whose keys open a cell."""
    browser.visit(live.url, 1280)
    browser.wait_for(SETTLED)
    seen = []
    for _ in range(40):
        browser.press("Tab")
        seen.append(browser.evaluate("document.activeElement.id || document.activeElement.textContent"))
        if seen[-1] == "map":
            break
    assert seen.count("Show its cells") == 2
    assert seen[-1] == "map"
    for key in ("ArrowRight", "ArrowUp", "Enter"):
        browser.press(key)
    browser.wait_for("document.querySelector('#cell h3')?.textContent.startsWith('Seed 2 at 0.34 %')")
    browser.wait_for("document.activeElement.id === 'cell'")


def test_a_cell_shows_sample_forces_and_record(browser: Chromium, live: Live) -> None:
    """An opened cell is that of the store, draws the forces of its packing, and names the command of its movie."""
    cell = measured(live.databases[0])
    browser.visit(live.url, 1280)
    browser.wait_for(SETTLED)
    browser.evaluate(f"location.hash = '#seed={cell.key.seed}&content={cell.key.content:g}'")
    browser.wait_for("document.querySelector('#sample canvas')?.width > 300 && document.getElementById('forces')")
    said = browser.evaluate("document.querySelector('#sample canvas').ariaLabel")
    assert f"{cell.p_contacts} P contacts, {cell.c_contacts} C contacts" in said
    assert f"Vs = {cell.vs:.4g} m/s" in browser.evaluate("document.querySelector('#cell h3').textContent")
    before = browser.evaluate("document.querySelector('#sample canvas').toDataURL()")
    browser.click_on("#forces")
    assert browser.evaluate("document.querySelector('#sample canvas').toDataURL()") != before
    browser.evaluate("(one => [one.focus(), one.click()])(document.querySelector('[data-zoom=\"2\"]'))")
    assert browser.evaluate("document.activeElement.dataset.zoom") == "2"  # to be pressed again
    command = browser.evaluate("document.querySelector('#more code').textContent")
    film = live.databases[0].parent / "wave.gif"
    subprocess.run(shlex.split(command.replace("wave.gif", str(film))), check=True)
    assert film.exists()


def test_the_other_campaign_can_be_chosen(browser: Chromium, live: Live) -> None:
    """The button of a campaign leads to its cells; a click on its small map opens one, also that open in the other."""
    browser.visit(live.url, 1280)
    browser.wait_for(SETTLED)
    assert browser.evaluate("document.getElementById('which').textContent").startswith("These are the cells of small")
    browser.evaluate("location.hash = '#seed=5&content=2.55'")
    is_open = "!document.getElementById('cell').hidden && "
    opened = f"{is_open}document.querySelector('#cell h3')?.textContent.startsWith('Seed 5 at 2.55 %: ')"
    browser.wait_for(opened)
    browser.evaluate("document.querySelectorAll('.campaign button')[1].click()")
    browser.wait_for("document.getElementById('count').textContent.startsWith('40 of 40 cells')")
    assert browser.evaluate("document.getElementById('cell').hidden")
    browser.click_on(".campaign:nth-child(2) canvas")
    browser.wait_for(opened.replace("2.55 %: ", "2.55 %: Vs = "))


@pytest.mark.mpi
def test_the_map_grows_during_a_run(browser: Chromium, workshop: "Workshop") -> None:
    """With --serve cells, means and status of a real run appear one after the other; it leaves no process."""
    workshop.configure(seeds=64)
    process = workshop.start("run", "c.toml", "--serve", "--ranks", "3")
    assert process.stdout is not None
    address = ADDRESS.fullmatch(process.stdout.readline())
    assert address
    browser.visit(address[1], 1280)
    counted, states, maps = [], set(), set()
    while process.poll() is None:
        share = browser.evaluate("document.querySelector('.campaign p:nth-of-type(3)')?.textContent") or ""
        states.add(browser.evaluate("document.querySelector('.campaign p:nth-of-type(2)')?.textContent"))
        if share and (not counted or share != counted[-1]):
            counted.append(share)
        maps |= {browser.evaluate("document.getElementById('map')?.toDataURL()")} - {None}  # before it is drawn
    finished = workshop.wait(process)
    assert finished.code == 0, finished.errors
    assert len(counted) > 2
    assert len(maps) > 2
    assert counted == sorted(counted, key=lambda text: int(text.split()[0]))
    assert any(state and state.startswith("Running on ") and "with 2 workers" in state for state in states)
    browser.wait_for("document.getElementById('connection').textContent.startsWith('The server has ended. All cells')")
    assert browser.evaluate("document.querySelector('.campaign p:nth-of-type(3)').textContent").startswith("192 of 192")
    assert "refused" not in finished.output + finished.errors
    assert address[3] not in finished.output + finished.errors
    assert workshop.leaves_no_process()
