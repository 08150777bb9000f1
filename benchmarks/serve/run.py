"""What the live page costs a run, and how long a large campaign takes to open.

    python benchmarks/serve/run.py [--commits N] [--url postgresql://...] [--cells 100000] [--rounds R]

A writer stores eight cells in a transaction, again and again with pauses, as rank 0 does. Its commits are timed alone,
and while the page is open in a browser that is told every change. Rounds take turns. Then a campaign of many cells is
opened in Chromium: seconds from the address to the first map, and to the map whose numbers were compared with their
checksums. `--url` names an empty database of a server, in which the writer stores too.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from statistics import median

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from chromium import Chromium, find_chromium, open_chromium
from live_page import serve

from calcidem.ends import CellStatus
from calcidem.storage.records import CampaignRecord, CellKey, CellResult, canonical_hash
from calcidem.storage.sql.store import Store

CONTENTS = tuple(place / 10 for place in range(100))
NUMERICS = {"frequency": 8e3, "time_step": 1e-7, "stability_limit": 1.2e-7, "steps": 3000}
PAUSE = 0.02
"""Seconds between two commits: a run of the paper's campaign makes some 5 in a second."""

CELLS_AT_ONCE = 8


def begin(store: Store, name: str, seeds: int) -> Iterator[CellResult]:
    """Plan a campaign, and give its outcomes."""
    hash_of_name = canonical_hash({"name": name})
    store.begin_campaign(CampaignRecord(hash_of_name, name, "{}", CONTENTS, tuple(range(seeds)), datetime.now(UTC)))
    draw = np.random.default_rng(1).normal
    for seed in range(seeds):
        for content in CONTENTS:
            vs = 400.0 + 120.0 * content + draw(0.0, 30.0)
            errors = {"numerical_error": 0.001, "reading_error": 0.03}
            yield CellResult(CellKey(seed, content), CellStatus.DONE, vs=vs, seconds=1.0, **NUMERICS, **errors)


def time_commits(database: str, name: str, commits: int, browser: Chromium | None) -> list[float]:
    """Seconds of each commit of a new campaign, with the page in a browser if there is one."""
    with ExitStack() as stack:
        store = stack.enter_context(Store(database))
        outcomes = begin(store, name, -(-commits * CELLS_AT_ONCE // len(CONTENTS)))
        outcome = next(outcomes)  # now it is planned
        store.acquire_lease()
        if browser is not None:
            live = stack.enter_context(serve(database, "--campaign", name))
            browser.visit(live.url, 1280)
            browser.wait_for("document.querySelector('#cells tbody tr')")
        seconds = []
        for _ in range(commits):
            batch = [outcome, *(next(outcomes) for _ in range(CELLS_AT_ONCE - 1))]
            start = time.perf_counter()
            store.record_results(batch)
            seconds.append(time.perf_counter() - start)
            outcome = next(outcomes, outcome)
            time.sleep(PAUSE)
        if browser is not None:
            told = f"document.querySelector('.campaign dd').textContent.replace(',', '') == '{commits * CELLS_AT_ONCE}'"
            browser.wait_for(told)
        return seconds


def compare_commits(database: str, commits: int, rounds: int, browser: Chromium) -> None:
    """Print the writer's times alone and with the page."""
    alone, watched = [], []
    for turn in range(rounds):
        alone += time_commits(database, f"alone{turn}", commits, None)
        watched += time_commits(database, f"watched{turn}", commits, browser)
    for name, seconds in (("alone", alone), ("with the page", watched)):
        ordered = sorted(seconds)
        high, most = ordered[int(0.99 * len(ordered))], ordered[-1]
        shown = ", ".join(f"{1e3 * value:.2f}" for value in (median(ordered), high, most))
        print(f"  {name:>14}: median, 99 %, longest commit {shown} ms of {len(ordered)}")


def time_opening(folder: Path, cells: int, browser: Chromium) -> None:
    """Print how long a campaign of so many cells takes to open."""
    database = folder / "large.db"
    with Store(database) as store:
        outcomes = list(begin(store, "large", cells // len(CONTENTS)))
        for at in range(0, len(outcomes), 1000):
            store.record_results(outcomes[at : at + 1000])
    with serve(database) as live:
        for name in ("first", "second"):
            start = time.perf_counter()
            browser.visit(live.url, 1280)
            browser.wait_for("document.querySelector('#cells tbody tr') && document.getElementById('map').width > 300")
            first = time.perf_counter() - start
            browser.wait_for(
                "document.querySelector('.campaign progress').value && !document.querySelector('.campaign').textContent.includes('compared')"
            )
            checked = time.perf_counter() - start
            print(f"  {name} browser: map after {first:.2f} s, checked after {checked:.1f} s")
    browser.send("Page.navigate", url="about:blank")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--commits", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cells", type=int, default=100_000)
    parser.add_argument("--url")
    given = parser.parse_args()
    program = find_chromium()
    if program is None:
        sys.exit("Chromium is not installed (Debian: apt-get install chromium)")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name, open_chromium(program, Path(name)) as browser:
        for database in (f"{name}/commits.db", *([given.url] if given.url else [])):
            print(f"{'SQLite' if database != given.url else 'server'}:")
            compare_commits(database, given.commits, given.rounds, browser)
        print(f"{given.cells:,} cells:")
        time_opening(Path(name), given.cells, browser)


if __name__ == "__main__":
    main()
