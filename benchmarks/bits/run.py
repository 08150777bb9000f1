"""The same bits on every processor: hashes of the real scene on faked ones.

    python benchmarks/bits/run.py [--scene paper] [--json FILE]
    python benchmarks/bits/run.py --verify quick.db paper.nc [--cells 20]
    python benchmarks/bits/run.py --on "AVX2, Zen" -- ./run-tests.sh --fast

The scene is the paper's packing of 4,663 disks, made anew on every processor, then cemented and crossed by waves in the
linear and the finite law, in one lane and in eight. ``--verify`` lets `calcidem verify` compute cells of databases
again, and of files that `calcidem import` makes databases of, on every processor. ``--on`` runs a command.
`on_aarch64.sh` beside this file runs a program on an emulated aarch64.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PROGRAM = ROOT / "tests" / "dem" / "bits" / "program.py"
sys.path.insert(0, str(PROGRAM.parent))

from processors import PROCESSORS, environment, playable

KINDS = ("packing", "step", "cement", "section", "Vs")
COMMAND = [sys.executable, "-c", "from calcidem.app.cli.main import main; main()"]


def hashes_on(processor: str, scene: str) -> dict[str, str]:
    """What the program prints on one processor."""
    command = [sys.executable, str(PROGRAM), scene]
    done = subprocess.run(command, env=environment(processor), stdout=subprocess.PIPE, text=True, check=True)
    return {line.split(" ", 1)[1]: line.split(" ", 1)[0] for line in done.stdout.splitlines()}


def show_hashes(scene: str) -> dict[str, dict[str, str]]:
    """Print the table: how many hashes of each kind are those of the first processor."""
    found: dict[str, dict[str, str]] = {}
    print("| processor |", " | ".join(KINDS), "|\n|---|", "---|" * len(KINDS), sep="", flush=True)
    for processor in playable():
        found[processor] = hashes_on(processor, scene)
        reference = next(iter(found.values()))
        cells = []
        for kind in KINDS:
            names = [name for name in reference if name.split(",")[0] == kind]
            same = sum(found[processor][name] == reference[name] for name in names)
            first = found[processor][names[0]][:6] if len(names) == 1 else "same"
            cells.append(f"{first} {same}/{len(names)}")
        print("|", processor, "|", " | ".join(cells), "|", flush=True)
    return found


def show_verdicts(files: list[str], cells: int) -> dict[str, dict[str, list[str | int]]]:
    """Print what ``verify`` says of the same cells of each database, with its exit code."""
    found: dict[str, dict[str, list[str | int]]] = {}
    print("| processor |", " | ".join(Path(file).name for file in files), "|\n|---|", "---|" * len(files), sep="")
    for processor in playable():
        found[processor] = {}
        for file in files:
            with tempfile.TemporaryDirectory() as folder:
                database, variables = file, environment(processor)
                if file.endswith(".nc"):
                    database = str(Path(folder, "imported.db"))
                    command = [*COMMAND, "import", file, "--db", database]
                    subprocess.run(command, env=variables, stdout=subprocess.DEVNULL, check=True)
                command = [*COMMAND, "verify", database, "--cells", str(cells), "--choice", "1"]
                done = subprocess.run(command, env=variables, stdout=subprocess.PIPE, text=True, check=False)
            found[processor][file] = [done.stdout.splitlines()[-1] if done.stdout else "", done.returncode]
        told = " | ".join(f"{text} Exit code {code}." for text, code in found[processor].values())
        print("|", processor, "|", told, "|", flush=True)
    return found


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=("small", "paper"), default="paper")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--verify", nargs="+")
    parser.add_argument("--cells", type=int, default=20)
    parser.add_argument("--on", choices=list(PROCESSORS))
    parser.add_argument("command", nargs="*")
    options = parser.parse_args()
    if options.on:
        os.execvpe(options.command[0], options.command, environment(options.on))  # noqa: S606 - the user's own command
    found: object = show_verdicts(options.verify, options.cells) if options.verify else show_hashes(options.scene)
    if options.json:
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
