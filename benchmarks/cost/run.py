"""How the cost of a sample grows with disks, lanes, calcite content and ranks.

    python benchmarks/cost/run.py [--json FILE] [--figure cost.png]

Kernel times are CPU seconds of one core, without compilation; those of the ranks are wall times of `calcidem run` on
a finished packing.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE.parent / "peers"))

from scenes import (
    Floats,
    as_scene,
    at_rest,
    cached_packing,
    moving,
    seconds_of_a_step,
    started,
    touching_pairs,
    with_time_step,
)

from calcidem.analysis.figures.style import BLUE, GREY, VERMILION, apply_style, letter_panels, new_figure, render
from calcidem.app.campaign.packing import provide_packing
from calcidem.app.config.reader import load_configuration
from calcidem.dem.engine.scene import Law, Precision
from calcidem.dem.engine.state import choose_features
from calcidem.dem.wave.measurement import measure

GRAINS = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
LANES = (1, 2, 4, 8, 16, 32)
ROUNDS = 5
SEEDS = tuple(range(1, 9))


def tiled(count: int) -> tuple[Floats, Floats, Floats]:
    """About ``count`` disks: the paper's packing, cut or laid side by side, in a box three times as high as wide."""
    stored = cached_packing()
    width, height = stored["size"]
    tiles = int(np.ceil(np.sqrt(count / len(stored["x"]))))
    columns, rows = np.meshgrid(np.arange(tiles), np.arange(tiles))
    x = np.concatenate([stored["x"] + column * width for column in columns.ravel()])
    y = np.concatenate([stored["y"] + row * height for row in rows.ravel()])
    size = np.sqrt(count / len(x))
    kept = (x < size * tiles * width) & (y < size * tiles * height)
    return x[kept], y[kept], np.tile(stored["radius"], tiles * tiles)[kept]


def cost_of_a_step(count: int, law: Law, lanes: int, precision: Precision = "float64") -> dict[str, float]:
    """CPU seconds of one step of all lanes, and the contacts it covers."""
    x, y, radius = tiled(count)
    rim = np.minimum.reduce([x, x.max() - x, y, y.max() - y]) - 2.0 * radius
    problem = with_time_step(moving(at_rest(x, y, radius, rim < 0.0, damping=0.3, skin=0.01), 1e-4), 0.3)
    state = started(problem, replace(choose_features(as_scene(problem), law, lanes), midpoint=False), precision)
    seconds = seconds_of_a_step(state, max(20, 400_000 // count), ROUNDS)
    return {"grains": len(x), "contacts": len(touching_pairs(x, y, radius)), "seconds": seconds}


def nanoseconds(row: dict[str, float], lanes: int) -> float:
    """Ns for one contact of one sample and one step."""
    return 1e9 * row["seconds"] / (row["contacts"] * lanes)


def over_grains() -> list[dict[str, Any]]:
    """Kernel time against the number of disks."""
    rows = []
    for law, count in product(("linear", "finite"), GRAINS):
        row = cost_of_a_step(count, law, 8)  # type: ignore[arg-type]
        rows.append({"law": law, **row, "ns": nanoseconds(row, 8)})
        print(f"{law:7} {row['grains']:7} disks {rows[-1]['ns']:6.2f} ns a contact-step", flush=True)
    return rows


def over_lanes() -> list[dict[str, Any]]:
    """Kernel time against the number of samples side by side."""
    rows = []
    for law, precision, lanes in product(("linear", "finite"), ("float64", "float32"), LANES):
        row = cost_of_a_step(4670, law, lanes, precision)  # type: ignore[arg-type]
        rows.append({"law": law, "precision": precision, "lanes": lanes, "ns": nanoseconds(row, lanes)})
        print(f"{law:7} {precision} {lanes:2} lanes {rows[-1]['ns']:6.2f} ns a contact-step", flush=True)
    return rows


def over_contents() -> list[dict[str, Any]]:
    """CPU seconds of a sample of the paper's campaign at each content."""
    configuration = load_configuration(ROOT / "examples" / "paper.toml")
    experiment = configuration.experiment(provide_packing(configuration, None))
    rows = []
    for content in configuration.campaign.contents:
        spent = []
        for _ in range(3):
            before = time.process_time()
            cells = measure(experiment, content, SEEDS)
            spent.append((time.process_time() - before) / len(SEEDS))
        rows.append({"content": content, "seconds": min(spent), "steps": cells[0].section.steps})
        print(f"{content:5} % {rows[-1]['steps']:6} steps {rows[-1]['seconds']:6.3f} s a sample", flush=True)
    return rows


def over_ranks() -> list[dict[str, Any]]:
    """Wall time of 8 seeds at the paper's contents without MPI, and with a master and one worker for each core."""
    rows = []
    text = (ROOT / "examples" / "paper.toml").read_text().replace("seeds = 116", "seeds = 16")
    for ranks in (1, 2, *range(3, 2 + (os.cpu_count() or 1))):
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "part.toml").write_text(text)
            command = [sys.executable, "-m", "calcidem", "run", "part.toml", "--ranks", str(ranks)]
            before = time.perf_counter()
            subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
            rows.append({"ranks": ranks, "workers": max(1, ranks - 1), "seconds": time.perf_counter() - before})
        print(f"{ranks} ranks: {rows[-1]['seconds']:.1f} s for {16 * 17} samples", flush=True)
    return rows


def print_growth(results: dict[str, Any]) -> None:
    """Print exponents of growth: slopes of least squares between the logarithms of size and time."""
    kinds = [(f"a step over disks, {law}", law, "grains", "seconds") for law in ("linear", "finite")]
    kinds += [(f"a sample over lanes, {law}", law, "lanes", "ns") for law in ("linear", "finite")]
    kinds += [("a campaign over workers", None, "ranks", "seconds")]
    sizes = {"ranks": "workers"}
    for title, law, table, spent in kinds:
        rows = [row for row in results[table] if row.get("law") == law and row.get("precision") != "float32"]
        size, time_spent = ([row[name] for row in rows] for name in (sizes.get(table, table), spent))
        print(f"{title}: exponent {np.polyfit(np.log(size), np.log(time_spent), 1)[0]:.2f}")


@apply_style
def draw(results: dict[str, Any]) -> Figure:
    """Four panels: disks, lanes, contents, ranks."""
    figure = new_figure(height=5.6, width=7.4)
    panels = grains, lanes, contents, ranks = figure.subplots(2, 2).ravel()
    for law, colour in (("linear", BLUE), ("finite", VERMILION)):
        rows = [row for row in results["grains"] if row["law"] == law]
        look: dict[str, Any] = {"color": colour, "markersize": 4}
        grains.plot([row["grains"] for row in rows], [row["ns"] for row in rows], "o-", label=f"{law} law", **look)
        for precision, bits, style in (("float64", 64, "o-"), ("float32", 32, "s--")):
            rows = [row for row in results["lanes"] if (row["law"], row["precision"]) == (law, precision)]
            places, times = ([row[name] for row in rows] for name in ("lanes", "ns"))
            lanes.plot(places, times, style, label=f"{law} law, {bits} bits", **look)
    cost = np.array([(row["content"], row["seconds"]) for row in results["contents"]]).T
    contents.plot(*cost, "o-", color=BLUE, markersize=4)
    workers, seconds = np.array([(row["workers"], row["seconds"]) for row in results["ranks"]]).T
    ranks.plot(workers, seconds, "o", color=BLUE, markersize=5, label="measured")
    ranks.plot(workers, seconds[0] / workers, ":", color=GREY, label="one worker's time, divided")
    titles = (
        ("disks", "ns a contact and step", "8 samples side by side"),
        ("samples side by side (lanes)", "ns a contact and step", "4,670 disks"),
        ("calcite content (% of sand mass)", "CPU seconds a sample", "a sample of the paper's campaign"),
        ("workers", f"seconds for {16 * 17} samples", "calcidem run --ranks"),
    )
    for axes, (horizontal, vertical, title) in zip(panels, titles, strict=True):
        axes.set(xlabel=horizontal, ylabel=vertical)
        axes.set_title(title)
        axes.set_ylim(bottom=0.0)
        if axes is not contents:
            axes.legend(fontsize=7)
    grains.set_xscale("log")
    lanes.set_xscale("log", base=2)
    lanes.set_xticks(LANES, [str(count) for count in LANES])
    ranks.set_xticks(sorted(set(workers.tolist())))
    letter_panels(panels)
    return figure


def main() -> None:
    """Measure, print, write and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    results = {"grains": over_grains(), "lanes": over_lanes(), "contents": over_contents(), "ranks": over_ranks()}
    print_growth(results)
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")
    if options.figure:
        options.figure.write_bytes(render(draw(results), "png"))


if __name__ == "__main__":
    main()
