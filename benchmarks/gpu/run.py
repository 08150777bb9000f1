"""What a GPU does for a campaign: bits, time of the kernel, and the cells of the paper, with and without it.

    python benchmarks/gpu/run.py [--parts sections profile campaign] [--seeds 116] [--ranks 9 17] [--json gpu.json]

For a machine with an NVIDIA card, and the extra `gpu` installed. Parts:

    sections  whole records of 32 samples on both, laws and precisions at 0.66 and 5 %; ns a contact-step on the card,
              of these 32 samples and of as many as the campaign has
    profile   where the time of one batch goes
    campaign  by each number of ranks on the GPU, twice: with and without the compilation of the kernels; then by the
              processor's cores, whose cells are compared

Results are printed and written after each step, so that an early end loses only what was not begun.
"""

import argparse
import cProfile
import io
import json
import os
import pstats
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PAPER = ROOT / "examples" / "paper.toml"
LANES, SAMPLES = 32, 1972
PARTS, TWICE = ("sections", "profile", "campaign"), ("", ", again")


class Clock:
    """Launches kernels; counts their seconds on the card and their steps, also with as many samples as fill the card."""

    def __init__(self, launch: Callable[..., None]) -> None:
        self.launch, self.seconds, self.contact_steps, self.sample_steps = launch, 0.0, 0, 0
        self.filled: dict[str, float] = {}

    def __call__(self, kernel: Any, shape: tuple[int, ...], *arguments: Any) -> None:  # noqa: ANN401 - on the card
        """Launch a kernel as `card.launch` does; the first time also with more samples."""
        steps, done, time_step, system, plan = arguments
        pairs = len(system.pairs.first)
        if not self.filled:
            times = SAMPLES // shape[0]
            wide = [widen(value, times) for value in (system, plan)]
            apart = widen(time_step, times, "samples")
            for _ in range(2):  # the first compiles
                begun = widen(done, times, "samples")
                seconds, taken = self.timed(kernel, (shape[0] * times, *shape[1:]), steps, begun, apart, *wide)
            self.filled = {
                "samples": shape[0] * times,
                "ns a contact-step": 1e9 * seconds / (taken * pairs),
                "us a sample-step": 1e6 * seconds / taken,
            }
        seconds, taken = self.timed(kernel, shape, steps, done, time_step, system, plan)
        self.seconds += seconds
        self.sample_steps += taken
        self.contact_steps += taken * pairs

    def timed(self, kernel: Any, shape: tuple[int, ...], steps: int, done: Any, *arguments: Any) -> tuple[float, int]:  # noqa: ANN401
        """Seconds of the card, and the steps of all samples."""
        from numba import cuda  # noqa: PLC0415 - where there is no GPU `sections` is not called

        before = int(done.copy_to_host().sum())
        begin, end = cuda.event(), cuda.event()
        begin.record()
        self.launch(kernel, shape, steps, done, *arguments)
        end.record()
        end.synchronize()
        return 1e-3 * cuda.event_elapsed_time(begin, end), int(done.copy_to_host().sum()) - before


def widen(value: Any, times: int, name: str = "") -> Any:  # noqa: ANN401 - a part of a system, or an array
    """Copy a part of a system on the card, with each sample as many times."""
    from numba import cuda  # noqa: PLC0415 - as above

    from calcidem.dem.kernels.gpu import card  # noqa: PLC0415

    if isinstance(value, tuple):
        return type(value)(*(widen(part, times, inner) for part, inner in zip(value, value._fields, strict=True)))  # type: ignore[attr-defined]
    if not hasattr(value, "copy_to_host"):
        return value
    here = value.copy_to_host()
    has_samples = name in card.WITH_LANES | card.BITS | {"force"} and here.ndim > 1
    return cuda.to_device(np.repeat(here, times, axis=0) if has_samples or name == "samples" else here)


def sections(content: float, law: str, precision: str) -> dict[str, Any]:
    """Whether whole records of a batch are the same on both, with seconds of both and of the kernel alone."""
    from calcidem.app.campaign.packing import provide_packing  # noqa: PLC0415 - after the path is set
    from calcidem.app.config.reader import change_configuration  # noqa: PLC0415
    from calcidem.dem.kernels.gpu import card  # noqa: PLC0415
    from calcidem.dem.wave.propagation import send_waves  # noqa: PLC0415

    values = {"wave.law": law, "wave.precision": precision}
    found, seconds, clock = [], [], Clock(card.launch)
    for gpu in (False, True):
        configuration = change_configuration(PAPER, values | {"run.gpu": gpu})
        experiment = configuration.experiment(provide_packing(configuration, None))
        bonded = [experiment.ordering(seed).at(content).bonded for seed in range(LANES)]
        for repetition in range(2):  # the first compiles, and proves the kernel
            card.launch = clock if repetition else clock.launch
            began = time.perf_counter()
            sent = send_waves(experiment, bonded, experiment.frequency(content), lanes=LANES)
            seconds.append(time.perf_counter() - began)
        found.append([(s.across.tobytes(), s.along.tobytes(), s.steps, s.remaining_speed, s.problem) for s in sent])
    card.launch = clock.launch
    return {
        "different sections": sum(one != other for one, other in zip(*found, strict=True)),
        "processor s": seconds[1],
        "first on the GPU s": seconds[2],
        "GPU s": seconds[3],
        "kernel s": clock.seconds,
        "ns a contact-step": 1e9 * clock.seconds / max(1, clock.contact_steps),
        "us a sample-step": 1e6 * clock.seconds / max(1, clock.sample_steps),
        "card filled": clock.filled,
    }


def batch_profile() -> list[str]:
    """Where the time of one batch at 0.66 % goes, of the second of two."""
    from calcidem.app.campaign.cells import CellComputation  # noqa: PLC0415
    from calcidem.app.campaign.packing import provide_packing  # noqa: PLC0415 - as above
    from calcidem.app.config.reader import change_configuration  # noqa: PLC0415
    from calcidem.sweep.schedule import Batch  # noqa: PLC0415

    configuration = change_configuration(PAPER, {"run.gpu": True, "run.lanes": LANES})
    compute = CellComputation(configuration, provide_packing(configuration, None))
    compute(Batch(tuple((seed, 0.66) for seed in range(LANES))), lambda: None)
    profile, text = cProfile.Profile(), io.StringIO()
    profile.runcall(compute, Batch(tuple((seed, 0.66) for seed in range(LANES, 2 * LANES))), lambda: None)
    pstats.Stats(profile, stream=text).sort_stats("tottime").print_stats(25)
    return [line for line in text.getvalue().splitlines() if line.strip()]


def campaign(folder: Path, seeds: int, ranks: int, *options: str) -> tuple[dict[str, float], list[list[Any]]]:
    """Seconds of `calcidem run`, and the numbers of its cells."""
    from calcidem import open_campaign  # noqa: PLC0415 - as above

    text = (
        PAPER.read_text(encoding="utf-8").replace("seeds = 116", f"seeds = {seeds}").replace("lanes = 16", "lanes = 32")
    )
    (folder / "c.toml").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "calcidem", "run", str(folder / "c.toml"), "--db", str(folder / "c.db")]
    command += ["--output", str(folder), "--ranks", str(ranks), *options]
    path = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    began = time.monotonic()
    subprocess.run(command, env=os.environ | {"PYTHONPATH": os.pathsep.join(path)}, check=True)
    spent = time.monotonic() - began
    with open_campaign(folder / "c.db") as opened:
        columns = ["content", "seed", "status", "vs", "effective_vs", "steps", "law", "numerical_error"]
        rows = opened.to_dataframe(columns).sort_values(["content", "seed"])
    return {"s": spent, "cells a second": len(rows) / spent}, json.loads(
        rows.to_json(orient="values", double_precision=15)
    )


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="*", default=PARTS, choices=PARTS, help="what to measure")
    parser.add_argument("--seeds", type=int, default=116, help="seeds of the campaign; 116 have 1,972 cells")
    parser.add_argument(
        "--ranks", type=int, nargs="*", default=[9, 17], help="ranks that share the GPU, one after another"
    )
    parser.add_argument("--json", type=Path, default=Path("gpu.json"), help="file for the results")
    asked = parser.parse_args()
    sys.path.insert(0, str(ROOT))
    card = subprocess.run(
        ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"],  # noqa: S607 - of the driver
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout.strip()
    found: dict[str, Any] = {}

    def keep(name: str, value: Any) -> None:  # noqa: ANN401 - of many types
        found[name] = value
        print(name, json.dumps(value, indent=1) if isinstance(value, dict) else value, flush=True)
        asked.json.write_text(json.dumps(found, indent=1), encoding="utf-8")

    keep("card", card)
    if "sections" in asked.parts:
        for law, precision in (("linear", "float32"), ("finite", "float32"), ("finite", "float64")):
            for content in (0.66, 5.0):
                keep(f"{law} law, {precision}, {content} %", sections(content, law, precision))
    if "profile" in asked.parts:
        keep("profile of a batch", batch_profile())
        print("\n".join(found["profile of a batch"]))
    if "campaign" not in asked.parts:
        return
    cells = {}
    for name, ranks, options in (
        *((f"campaign on the GPU, {ranks} ranks{times}", ranks, ["--gpu"]) for ranks in asked.ranks for times in TWICE),
        *((f"campaign on the processor, {asked.ranks[-1]} ranks{times}", asked.ranks[-1], []) for times in TWICE),
    ):
        with tempfile.TemporaryDirectory(prefix="calcidem-gpu-") as folder:
            seconds, cells[name] = campaign(Path(folder), asked.seeds, ranks, *options)
        keep(name, seconds)
    (*_, last) = cells.values()
    keep(
        "cells other than the processor's",
        {name: sum(a != b for a, b in zip(rows, last, strict=True)) for name, rows in cells.items()},
    )


if __name__ == "__main__":
    main()
