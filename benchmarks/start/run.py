"""Where time goes beside the kernel: libraries, compilation, the first command, and the phases of a campaign.

    python benchmarks/start/run.py [--ranks R] [--seeds N] [--config examples/paper.toml] [--json FILE]

Seconds of the processor (user and system) of whole processes or of the main thread, and of the clock where people
wait. `--seeds` gives the seeds of the campaign whose phases are told apart; 0 leaves it out. Of its samples at 0.66 and
5 %, milliseconds a sample beside the kernel are told, without and with lists of neighbours, and nanoseconds of the
kernel a contact-step: one listed pair of one lane advanced by one step.
"""

import argparse
import contextlib
import importlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

LIBRARIES = {
    "Python alone": "pass",
    "a worker": "import calcidem.app.campaign.run",
    "rank 0": "import calcidem.app.campaign.run, calcidem.app.cli.views, calcidem.app.config.reader",
}

KERNELS = """
import json, sys, time
from calcidem.app.campaign.packing import kept_packing
from calcidem.app.campaign.cells import kernel_compilations
from calcidem.app.config.reader import load_configuration
from calcidem.dem.engine.scene import Sand
from calcidem.dem.sample.packing import PackingRule
from calcidem.dem.sample.compaction import make_packing
from calcidem.dem.sample.cement import RandomPurpose, random_generator
configuration = load_configuration(sys.argv[1], {})
found = {}
def clock(name, action):
    began = time.process_time()
    action()
    found[name] = time.process_time() - began
rule = PackingRule(width=0.02, height=0.02, expansion_steps=1)
generator = random_generator(0, 1, RandomPurpose.DISKS)
moved, began = [], time.process_time()
clock("a packing", lambda: make_packing(rule, Sand(), generator, lambda: moved.append(time.process_time() - began)))
found["of this until it has moved"] = moved[1] - moved[0]
packing = kept_packing(configuration.packing_hash)
for name, action in zip(("samples", "check samples"), kernel_compilations(configuration, packing)):
    clock(f"wave: {name}", action)
print(json.dumps(found))
"""

PHASES = {
    "kernel": ("calcidem.dem.engine.leapfrog.advance_steps",),
    "scenes: neighbours, forces, step": ("calcidem.dem.wave.propagation.prepare_recorder",),
    "lists of neighbours": ("calcidem.dem.engine.leapfrog.renew_assembly",),
    "drawing cement": ("calcidem.dem.wave.experiment.draw_cement",),
    "looks at the records": ("calcidem.dem.wave.propagation.is_settled",),
    "guards": ("calcidem.dem.wave.propagation.problems_of",),
    "readings and their errors": ("calcidem.dem.wave.measurement.interpret",),
    "other work of the checks": ("calcidem.app.campaign.cells.check_content",),
    "other work of a batch": ("calcidem.app.campaign.cells.measure",),
    "path and graph": ("calcidem.app.campaign.cells._describe_graph",),
    "rows, compressed": ("calcidem.app.campaign.cells.cell_result", "calcidem.storage.records.pack_arrays"),
    "other work of the sweep": ("calcidem.app.campaign.run.run_sweep",),
    "NetCDF": ("calcidem.storage.netcdf.export_netcdf",),
}


class Phases:
    """Processor seconds of the main thread in each phase, without those of phases within it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._inner = [0.0]
        for phase, places in PHASES.items():
            for place in places:
                owner, _, name = place.rpartition(".")
                module = importlib.import_module(owner)
                setattr(module, name, self._timed(phase, getattr(module, name)))

    def _timed(self, phase: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, with its time counted."""

        def call(*arguments: Any, **named: Any) -> Any:  # noqa: ANN401 - any function
            began = time.thread_time()
            self._inner.append(0.0)
            try:
                return function(*arguments, **named)
            finally:
                spent = time.thread_time() - began
                self.seconds[phase] += spent - self._inner.pop()
                self._inner[-1] += spent

        return call


def children_seconds() -> float:
    """Processor seconds of the processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def run_python(program: str, *arguments: str, cache: Path | None = None) -> tuple[float, str]:
    """Processor seconds and output of a program."""
    environment = os.environ | ({} if cache is None else {"NUMBA_CACHE_DIR": str(cache)})
    began = children_seconds()
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], check=True, capture_output=True, text=True, env=environment
    )
    return children_seconds() - began, done.stdout


def run_command(configuration: Path, ranks: int, folder: Path, cache: Path) -> dict[str, float]:
    """Seconds of `calcidem run`: of the clock until rank 0 says that it computes cells, of all, and of the processor.

    Packings that it makes are kept beside the kernels.
    """
    command = [sys.executable, "-m", "calcidem", "run", str(configuration), "--db", str(folder / "c.db")]
    command += ["--output", str(folder), *(["--ranks", str(ranks)] if ranks > 1 else [])]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "CALCIDEM_CACHE": str(cache), "PYTHONUNBUFFERED": "1"}
    used, began = children_seconds(), time.monotonic()
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    found: dict[str, float] = {}
    for line in process.stdout or ():
        if " batches on " in line:
            found.setdefault("until cells are computed", time.monotonic() - began)
    process.wait()
    return found | {"whole command": time.monotonic() - began, "processor": children_seconds() - used}


def sample_costs(configuration: Path, content: float, lanes: int = 16) -> dict[str, float]:
    """Cost of the samples of one batch, in the second of two runs, whose constants the worker has kept."""
    task = importlib.import_module("calcidem.app.campaign.cells")
    packing = importlib.import_module("calcidem.app.campaign.packing")
    reader = importlib.import_module("calcidem.app.config.reader")
    values = {"campaign.seeds": lanes, "campaign.contents": [content], "run.lanes": lanes}
    loaded = reader.change_configuration(reader.load_configuration(configuration, {}), values)
    compute = task.CellComputation(loaded, packing.kept_packing(loaded.packing_hash))
    seeds = loaded.campaign.seed_numbers
    batch = importlib.import_module("calcidem.sweep.schedule").Batch(tuple((seed, content) for seed in seeds))
    compute(batch, lambda: None)
    leapfrog, steps = importlib.import_module("calcidem.dem.engine.leapfrog"), []
    kernel = leapfrog.advance_steps

    def counted(features: Any, count: int, time_step: Any, system: Any) -> int:  # noqa: ANN401 - of the kernel
        done: int = kernel(features, count, time_step, system)
        steps.append(done * len(system.pairs.first) * lanes)
        return done

    leapfrog.advance_steps = counted
    phases = Phases()
    began = time.thread_time()
    compute(batch, lambda: None)
    spent = time.thread_time() - began
    in_kernel, in_lists = phases.seconds["kernel"], phases.seconds["lists of neighbours"]
    return {
        "host ms a sample without lists": 1e3 * (spent - in_kernel - in_lists) / lanes,
        "host ms a sample with lists": 1e3 * (spent - in_kernel) / lanes,
        "ns a contact-step": 1e9 * in_kernel / sum(steps),
    }


def campaign_phases(configuration: Path, seeds: int) -> dict[str, float]:
    """Processor seconds of the phases of a campaign in this process, kernels taken from the cache."""
    phases = Phases()
    run = importlib.import_module("calcidem.app.campaign.run")
    export = importlib.import_module("calcidem.storage.netcdf")
    store_module = importlib.import_module("calcidem.storage.sql.store")
    with scratch() as folder:
        values = {"campaign.seeds": seeds, "run.database": str(folder / "c.db"), "run.output": str(folder)}
        run.run(configuration, set=values, progress=False).close()
        with store_module.Store(folder / "c.db", read_only=True) as store:
            store.use_campaign()
            export.export_netcdf(store, folder / "c.nc")
    return dict(phases.seconds)


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """A folder for a moment."""
    with tempfile.TemporaryDirectory(prefix="calcidem-start-") as folder:
        yield Path(folder)


def show(title: str, values: dict[str, float], unit: str = "s") -> None:
    """Print a table."""
    print(f"\n{title}")
    for name, value in values.items():
        print(f"  {name:40s} {value:8.2f} {unit}".rstrip())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", type=Path, default=ROOT / "examples" / "paper.toml")
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found: dict[str, dict[str, float]] = {}
    found["libraries"] = {name: run_python(program)[0] for name, program in LIBRARIES.items()}
    show("Loading libraries, processor", found["libraries"])
    with scratch() as cache:
        for title in ("compiling", "loading kernels from the cache"):
            found[title] = json.loads(run_python(KERNELS, str(options.config), cache=cache)[1])
            show(f"{title.capitalize()}, processor", found[title])
    quick = (ROOT / "examples" / "quick.toml").read_text(encoding="utf-8")
    for packing, seed in (("shipped packing", 1), ("another packing", 31)):
        with scratch() as folder, scratch() as cache:
            text = quick.replace("[packing]\nseed = 1\n", f"[packing]\nseed = {seed}\n")
            (folder / "quick.toml").write_text(text, encoding="utf-8")
            for title in (f"first command, {packing}", f"same command again, {packing}"):
                (folder / "c.db").unlink(missing_ok=True)
                found[title] = run_command(folder / "quick.toml", options.ranks, folder, cache)
                show(f"{title.capitalize()}, quick.toml on {options.ranks} ranks", found[title])
    if options.seeds:
        campaign_phases(options.config, 1)  # compiles, if need be
        found["campaign"] = campaign_phases(options.config, options.seeds)
        show(f"Campaign of {options.seeds} seeds, one process, processor", found["campaign"])
        for content in (0.66, 5.0):
            title = f"samples at {content:g} %"
            found[title] = sample_costs(options.config, content)
            show(title.capitalize(), found[title], "")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
