"""What a GPU does for a campaign: bits, time of the kernel, and the cells of the paper, with and without it.

    python benchmarks/gpu/run.py [--seeds 116] [--ranks 9 17] [--wheels DIR] [--json gpu.json]

For a machine with an NVIDIA card and 15 minutes: it installs the extra `gpu` where numba-cuda is missing (`--wheels`:
from a folder, without network), and takes about

     1 to 4 minutes  compilation of the kernels
           1 minute  sections of whole records on both, laws and precisions at 0.66 and 5 %, with ns a contact-step
           1 minute  a profile of one batch
     1 to 2 minutes  the campaign by each number of ranks on the GPU
           2 minutes the same by the processor's cores, whose cells are compared

Results are printed and written after each part, so that an early end loses only what was not begun.
"""

import argparse
import cProfile
import importlib.util
import io
import json
import os
import pstats
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PAPER = ROOT / "examples" / "paper.toml"
LANES = 32


def install(wheels: str | None) -> None:
    """Install the extra, unless it is there, and begin again: numba-cuda takes the place of numba's at the start."""
    if importlib.util.find_spec("numba_cuda") is None:
        source = [] if wheels is None else ["--no-index", "--find-links", wheels]
        wanted = ["numba-cuda[cu13]>=0.30.4", "numpy<2.5"]
        subprocess.run([sys.executable, "-m", "pip", "install", "-q", *source, *wanted], check=True)
        os.execv(sys.executable, [sys.executable, *sys.argv])  # noqa: S606 - this program


class Clock:
    """A kernel whose seconds on the card, samples and steps are counted."""

    def __init__(self, kernel: Any) -> None:  # noqa: ANN401 - of numba-cuda
        self.kernel, self.seconds, self.contact_steps, self.sample_steps = kernel, 0.0, 0, 0

    def __getitem__(self, shape: tuple[int, int]) -> Any:  # noqa: ANN401 - what launches it
        from numba import cuda  # noqa: PLC0415 - installed by this program

        def launch(steps: int, done: Any, time_step: Any, system: Any, plan: Any) -> None:  # noqa: ANN401 - on the card
            before = int(done.copy_to_host().sum())
            begin, end = cuda.event(), cuda.event()
            begin.record()
            self.kernel[shape](steps, done, time_step, system, plan)
            end.record()
            end.synchronize()
            taken = int(done.copy_to_host().sum()) - before
            self.seconds += 1e-3 * cuda.event_elapsed_time(begin, end)
            self.sample_steps += taken
            self.contact_steps += taken * len(system.pairs.first)

        return launch


def sections(content: float, law: str, precision: str) -> dict[str, Any]:
    """Whether whole records of a batch are the same on both, with seconds of both and of the kernel alone."""
    from calcidem.app.campaign.packing import provide_packing  # noqa: PLC0415 - after numba-cuda is installed
    from calcidem.app.config.reader import change_configuration  # noqa: PLC0415
    from calcidem.dem.kernels.gpu import card  # noqa: PLC0415
    from calcidem.dem.wave.propagation import send_waves  # noqa: PLC0415

    values = {"wave.law": law, "wave.precision": precision}
    found, seconds, make = [], [], card.gpu_kernel
    clocks: list[Clock] = []

    def timed(*arguments: Any) -> Clock:  # noqa: ANN401 - of `gpu_kernel`
        clocks.append(Clock(make(*arguments)))
        return clocks[-1]

    for gpu in (False, True):
        configuration = change_configuration(PAPER, values | {"run.gpu": gpu})
        experiment = configuration.experiment(provide_packing(configuration, None))
        bonded = [experiment.ordering(seed).at(content).bonded for seed in range(LANES)]
        for repetition in range(2):  # the first compiles, and proves the kernel
            clocks.clear()
            card.gpu_kernel = timed if repetition else make
            began = time.perf_counter()
            sent = send_waves(experiment, bonded, experiment.frequency(content), lanes=LANES)
            seconds.append(time.perf_counter() - began)
        found.append([(s.across.tobytes(), s.along.tobytes(), s.steps, s.remaining_speed, s.problem) for s in sent])
    card.gpu_kernel = make
    kernel, steps = sum(c.seconds for c in clocks), sum(c.contact_steps for c in clocks)
    return {
        "different sections": sum(one != other for one, other in zip(*found, strict=True)),
        "processor s": seconds[1],
        "first on the GPU s": seconds[2],
        "GPU s": seconds[3],
        "kernel s": kernel,
        "ns a contact-step": 1e9 * kernel / max(1, steps),
        "us a sample-step": 1e6 * kernel / max(1, sum(c.sample_steps for c in clocks)),
    }


def batch_profile() -> list[str]:
    """Where the time of one batch at 0.66 % goes, of the second of two."""
    from calcidem.app.campaign.cells import CellComputation  # noqa: PLC0415
    from calcidem.app.campaign.packing import provide_packing  # noqa: PLC0415 - as above
    from calcidem.app.config.reader import change_configuration  # noqa: PLC0415
    from calcidem.sweep.batch import Batch  # noqa: PLC0415

    configuration = change_configuration(PAPER, {"run.gpu": True, "run.lanes": LANES})
    compute = CellComputation(configuration, provide_packing(configuration, None))
    compute(Batch(0, tuple((seed, 0.66) for seed in range(LANES))), lambda: None)
    profile, text = cProfile.Profile(), io.StringIO()
    profile.runcall(compute, Batch(0, tuple((seed, 0.66) for seed in range(LANES, 2 * LANES))), lambda: None)
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
    began = time.monotonic()
    subprocess.run(command, env=os.environ | {"PYTHONPATH": str(ROOT)}, check=True)
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
    parser.add_argument("--seeds", type=int, default=116, help="seeds of the campaign; 116 have 1,972 cells")
    parser.add_argument(
        "--ranks", type=int, nargs="*", default=[9, 17], help="ranks that share the GPU, one after another"
    )
    parser.add_argument("--wheels", help="folder of wheels, where there is no network")
    parser.add_argument("--json", type=Path, default=Path("gpu.json"), help="file for the results")
    asked = parser.parse_args()
    install(asked.wheels)
    sys.path.insert(0, str(ROOT))
    card = subprocess.run(
        ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"],  # noqa: S607 - of the driver
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout.strip()
    found: dict[str, Any] = {"card": card}

    def keep(name: str, value: Any) -> None:  # noqa: ANN401 - of many types
        found[name] = value
        print(name, json.dumps(value, indent=1) if isinstance(value, dict) else value, flush=True)
        asked.json.write_text(json.dumps(found, indent=1), encoding="utf-8")

    keep("card", card)
    cells = {}
    for law, precision in (("finite", "float32"), ("linear", "float32"), ("finite", "float64")):
        for content in (0.66, 5.0):
            keep(f"{law} law, {precision}, {content} %", sections(content, law, precision))
    profile = batch_profile()
    keep("profile of a batch", profile)
    print("\n".join(profile))
    for name, ranks, options in (
        *((f"campaign on the GPU, {ranks} ranks", ranks, ["--gpu"]) for ranks in asked.ranks),
        ("campaign on the processor", 0, []),
    ):
        with tempfile.TemporaryDirectory(prefix="calcidem-gpu-") as folder:
            seconds, cells[name] = campaign(Path(folder), asked.seeds, ranks, *options)
        keep(name, seconds)
    last = cells["campaign on the processor"]
    keep(
        "cells other than the processor's",
        {name: sum(a != b for a, b in zip(rows, last, strict=True)) for name, rows in cells.items()},
    )


if __name__ == "__main__":
    main()
