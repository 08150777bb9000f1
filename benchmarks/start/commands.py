"""Processor seconds of every command that only looks at a campaign, and the imports that cost it most.

    python benchmarks/start/commands.py [--repeat N] [--large FILE.nc] [--json FILE]

Seconds are user and system time of the whole process, the median of the repetitions. The first row is the floor of all
that read a database: NumPy and SQLAlchemy alone. `--large` also makes the report of an exported campaign, such as the
1,972 cells in calcidem/app/config/presets/paper.nc. The imports of a package count where they are first asked for, as
`python -X importtime` measures them, which slows each down by about a half.
"""

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

DATABASE = ROOT / "docs" / "tutorial" / "quick.db"

_FLOOR = ["-c", "import numpy, sqlalchemy"]

COMMANDS = {
    "import of NumPy, SQLAlchemy": _FLOOR,
    "--help": ["--help"],
    "status": ["status", "quick.db"],
    "status --format json": ["status", "quick.db", "--format", "json"],
    "query": ["query", "quick.db"],
    "show": ["show", "quick.db", "--seed", "1", "--content", "5"],
    "show --out": ["show", "quick.db", "--seed", "1", "--content", "5", "--out", "figures"],
    "export": ["export", "quick.db", "new.nc"],
    "import": ["import", "quick.nc", "--db", "copy.db"],
    "predict": ["predict", "quick.db"],
    "report": ["report", "quick.db", "--out", "report.html"],
}

WANTED = {"status": 0.7, "query": 0.7, "show": 0.7, "export": 0.7, "import": 1.5, "predict": 3.0, "report": 3.0}
"""Seconds at most, on one core of an AMD Zen 5."""

_LARGE_REPORT = ["report", "large.db", "--out", "large.html"]


def run_command(arguments: list[str], folder: Path, *options: str) -> tuple[float, str]:
    """Processor seconds of a command, and what it wrote as errors."""
    for made in ("copy.db", "new.nc"):
        (folder / made).unlink(missing_ok=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, *options, *([] if arguments is _FLOOR else ["-m", "calcidem"]), *arguments],
        check=False,
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"COLUMNS": "120", "OPENBLAS_NUM_THREADS": "1"},
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"calcidem {' '.join(arguments)} ended with {done.returncode}:\n{done.stderr}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stderr


def dearest_imports(errors: str, number: int = 5) -> list[tuple[str, float]]:
    """Packages whose own modules took most seconds to import, by what `-X importtime` wrote."""
    seconds: Counter[str] = Counter()
    for line in errors.splitlines():
        own, _, rest = line.removeprefix("import time:").partition("|")
        if line.startswith("import time:") and own.strip().isdigit():
            seconds[rest.partition("|")[2].strip().partition(".")[0]] += int(own)
    return [(name, microseconds / 1e6) for name, microseconds in seconds.most_common(number)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--large", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory(prefix="calcidem-start-") as scratch:
        folder = Path(scratch)
        shutil.copy(DATABASE, folder / "quick.db")
        run_command(["export", "quick.db", "quick.nc"], folder)
        for name, arguments in COMMANDS.items():
            found[name] = statistics.median(run_command(arguments, folder)[0] for _ in range(options.repeat))
            imports = dearest_imports(run_command(arguments, folder, "-X", "importtime")[1])
            wanted = f"(wanted {WANTED[name]:.1f})" if name in WANTED else ""
            told = ", ".join(f"{package} {seconds:.2f}" for package, seconds in imports)
            print(f"{name:27s} {found[name]:6.2f} s {wanted:13s} {told}", flush=True)
        if options.large:
            run_command(["import", str(options.large.resolve()), "--db", "large.db"], folder)
            found["report, large"] = run_command(_LARGE_REPORT, folder)[0]
            size = (folder / "large.html").stat().st_size / 1e6
            print(
                f"report of {options.large.name}: {found['report, large']:.1f} s (wanted 12.0), page of {size:.2f} MB"
            )
    if options.json:
        options.json.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
