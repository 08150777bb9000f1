"""Seconds and memory of opening, reading, summarising and exporting databases of 1,972 to 1,000,000 cells.

    python benchmarks/store/run.py [--cells 1972 50000 1000000] [--folder DIR] [--figure docs/store.png]

Each database is made of records like those of a run, without signals and cement. Each question is asked in a process of
its own; its memory is the most that the process ever had beyond what it had after importing calcidem. Seconds are those
on the clock, and in brackets those of computing, which other work on the machine does not change much.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from itertools import cycle, islice
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from calcidem.analysis.distribution import tabulate
from calcidem.app.campaign.opened import Campaign, open_campaign
from calcidem.app.campaign.packing import packing_record, provide_packing
from calcidem.app.config.schema import Configuration
from calcidem.ends import CellStatus
from calcidem.storage.netcdf import export_netcdf, import_netcdf
from calcidem.storage.records import (
    CampaignRecord,
    CellKey,
    CellResult,
    NetworkFeatures,
    PathFeatures,
    Selection,
    canonical_hash,
    canonical_json,
)
from calcidem.storage.sql.store import Store, read_campaign

CONTENTS = tuple(0.5 * i for i in range(17))

BLOCK = 10_000
"""Cells of one transaction."""

ROOT = Path(__file__).parents[2]


def cells(seeds: int) -> Iterator[CellResult]:
    """Outcomes as a run gives them: velocities about normal, one in a hundred without arrival."""
    generator = np.random.default_rng(1)
    for seed in range(1, seeds + 1):
        scatter = generator.normal(1.0, 0.05, len(CONTENTS)).tolist()
        for content, factor in zip(CONTENTS, scatter, strict=True):
            key = CellKey(seed, content)
            if seed % 100 == 0:
                yield CellResult(
                    key,
                    CellStatus.NO_ARRIVAL,
                    "the receiver has no peak within half a period of the fitted wave",
                    rank=1,
                )
                continue
            yield CellResult(
                key,
                CellStatus.DONE,
                vs=(300.0 + 200.0 * content) * factor,
                vs_peak=(300.0 + 200.0 * content) * factor,
                coherence=0.9,
                frequency=15e3,
                time_step=8e-8,
                stability_limit=1e-7,
                steps=12_000,
                numerical_error=6e-4,
                content_reached=content,
                p_contacts=400,
                c_contacts=900,
                clusters=250,
                bonded_contacts=1300,
                seconds=0.1,
                rank=3,
                host="node7",
                features=PathFeatures(41, 1, 40, 40 / 41, 0.5, 20, 12.1, 0.1),
                network=NetworkFeatures(0.04, 0.4, 0.4, 2.8, -0.01, 20, 4100, 1),
            )


def make_database(path: Path, count: int) -> None:
    """Plan and store the cells."""
    seeds = math.ceil(count / len(CONTENTS))
    config = {"wave": {"transmitter_half_width": 0.01, "receiver_half_width": 0.03}}
    record = CampaignRecord(
        hash=canonical_hash(config),
        name="large",
        config=canonical_json(config),
        contents=CONTENTS,
        seeds=tuple(range(1, seeds + 1)),
        created=datetime.now(UTC),
    )
    packing = provide_packing(Configuration(), None)
    with Store(path) as store:
        store.begin_campaign(record)
        store.save_packing(packing_record(packing, index=0, packing_hash=Configuration().packing_hash))
        stored = cells(seeds)
        while block := list(islice(stored, BLOCK)):
            store.record_results(block)


def ask_select(campaign: Campaign) -> None:
    """Fetch the records of one content."""
    for _ in campaign.select(content=5.0, status="done"):
        pass


def ask_export(campaign: Campaign) -> None:
    """Export, beside the database."""
    path = campaign.store.address.path  # type: ignore[attr-defined]  # a SQLite store
    export_netcdf(campaign.store, path.with_suffix(".nc"))


def ask_import(campaign: Campaign) -> None:
    """Import the exported file into a new database."""
    path = campaign.store.address.path  # type: ignore[attr-defined]  # a SQLite store
    with Store(path.with_suffix(".copy.db")) as store:
        import_netcdf(path.with_suffix(".nc"), store)


def ask_query(campaign: Campaign) -> None:
    """Find the ten fastest cells of one content, as `calcidem query` does."""
    path = str(campaign.store.address.path)  # type: ignore[attr-defined]  # a SQLite store
    with read_campaign(path) as store:
        store.table(
            ("seed", "content", "status", "vs", "vs_error", "seconds"),
            Selection(contents=(5.0,), where="vs > 1300"),
            sort=("-vs",),
            limit=10,
        )


QUESTIONS: dict[str, tuple[str, Callable[[Campaign], object]]] = {
    "open": ("`open_campaign(file)`", lambda _: None),
    "vs": ("`vs()`", Campaign.vs),
    "one": ("`cell(seed=3, content=5.0)`", lambda campaign: campaign.cell(seed=3, content=5.0)),
    "select": ('`select(content=5.0, status="done")`', ask_select),
    "query": ('`query --content 5 --where "vs > 1300" --sort=-vs --limit 10`', ask_query),
    "counts": ("`status_counts()`", Campaign.status_counts),
    "summary": ("`summary()`", Campaign.summary),
    "dataset": ("`to_xarray()`", Campaign.to_xarray),
    "frame": ("`to_dataframe()`", Campaign.to_dataframe),
    "export": ("`export` to NetCDF", ask_export),
    "import": ("`import` of that file", ask_import),
}


def peak_memory() -> float:
    """Return the most memory that this process ever had, MB; what `getrusage` says begins with its parent's."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return float(status.partition("VmHWM:")[2].split()[0]) / 1024


def ask(name: str, path: Path) -> dict[str, float]:
    """Answer one question in this process: seconds, and MB of memory."""
    # What every process imports for these questions, so that it doesn't count as theirs.
    assert tabulate  # noqa: S101 - named for the reader
    before = peak_memory()
    start, cpu = time.perf_counter(), time.process_time()
    with open_campaign(path) as campaign:
        QUESTIONS[name][1](campaign)
    seconds = time.perf_counter() - start
    return {"seconds": seconds, "cpu": time.process_time() - cpu, "MB": peak_memory() - before}


def ask_elsewhere(name: str, path: Path) -> dict[str, float]:
    """Answer one question in a process of its own."""
    command = [sys.executable, __file__, "--ask", name, "--file", str(path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT)
    answer: dict[str, float] = json.loads(done.stdout)
    return answer


def main() -> None:
    """Make the databases, ask all questions and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[1972, 50_000, 1_000_000])
    parser.add_argument("--folder", type=Path, help="where to keep the databases; a temporary folder without")
    parser.add_argument("--figure", type=Path, default=ROOT / "docs" / "store.png", help="picture to draw")
    parser.add_argument("--ask", choices=QUESTIONS, help=argparse.SUPPRESS)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.ask:
        print(json.dumps(ask(options.ask, options.file)))
        return
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as temporary:
        for count in options.cells:
            path = (options.folder or Path(temporary)) / f"cells_{count}.db"
            if not path.exists():
                start, cpu = time.perf_counter(), time.process_time()
                make_database(path, count)
                spent = time.perf_counter() - start, time.process_time() - cpu
                rows.append((count, "making it", *spent, 0.0))
            print(f"{path}: {path.stat().st_size / 1e6:.1f} MB", flush=True)
            path.with_suffix(".copy.db").unlink(missing_ok=True)
            for name, (title, _) in QUESTIONS.items():
                answer = ask_elsewhere(name, path)
                rows.append((count, title, answer["seconds"], answer["cpu"], answer["MB"]))
                print(
                    f"{count:>9} {title:<70} {answer['seconds']:9.3f} s ({answer['cpu']:.3f}) {answer['MB']:6.0f} MB",
                    flush=True,
                )
    print(markdown(rows))
    draw(rows, options.figure)
    print(f"Figure: {options.figure}")


Row = tuple[int, str, float, float, float]
"""Cells, question, seconds on the clock, seconds of computing, MB."""


def draw(rows: list[Row], file: Path) -> None:
    """Draw seconds of computing against cells, a line for each question."""
    figure, axes = plt.subplots(figsize=(7.2, 6.0), layout="constrained")
    colors, markers = cycle([*mpl.color_sequences["tab10"], "black"]), cycle("os^vD")
    for title, _ in QUESTIONS.values():
        points = sorted((count, cpu) for count, name, _, cpu, _ in rows if name == title)
        line = {"marker": next(markers), "markersize": 5, "color": next(colors)}
        axes.plot(*zip(*points, strict=True), label=title.replace("`", ""), **line)
    axes.set(xscale="log", yscale="log", xlabel="cells in the database", ylabel="seconds of computing")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    figure.savefig(file, dpi=120)


def markdown(rows: list[Row]) -> str:
    """Return the answers as a table: a line a question, two columns a database."""
    counts = list(dict.fromkeys(count for count, *_ in rows))
    head = "".join(f" {count:,} cells: s (computing) | MB |" for count in counts)
    lines = [f"| question |{head}", "|---|" + "---:|---:|" * len(counts)]
    for title in dict.fromkeys(title for _, title, *_ in rows):
        found = {
            count: f" {clock:.2f} ({cpu:.2f}) | {size:.0f} |" for count, name, clock, cpu, size in rows if name == title
        }
        lines.append(f"| {title} |" + "".join(found.get(count, " | |") for count in counts))
    return "\n".join(lines)


if __name__ == "__main__":
    main()
