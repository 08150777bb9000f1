"""A long run: memory, descriptors, log and database against the cells that are stored, over a stop and a full disk.

    python benchmarks/endurance/run.py --cells 100000 [--ranks 2] [--rows 10] [--stops 1] [--disk MB] [--clock]
                                       [--folder DIR] [--gpu]

The campaign has 280 disks and eight contents. `--stops` ends the run so many times at equal distances with SIGTERM, and
goes on with the same command. `--disk` (needs root) gives the folder a file system of so many MB: the run ends when it
is full, the file system is made larger, and the same command goes on. `--clock` (needs a C compiler) moves the time of day
by 25 hours at each row of the table, forwards and back in turns. In the end some cells are computed again:
`calcidem verify` tells whether their bits are those that were stored. Exit code 1 if anything is not as it should be.
"""

import argparse
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SMALL_PACKING = ROOT / "tests" / "assets" / "small_packing.npz"
CONTENTS = (0.24, 0.66, 1.1, 2.55, 4.0, 5.0, 7.0, 9.0)
CONFIGURATION = """
[campaign]
name = "endurance"
seeds = {seeds}
contents = {contents}
[packing]
width = 0.03
height = 0.06
unbalanced_force_ratio = 1e-5
[sand]
wave_stiffness_factor = 4.7
[wave]
receiver_half_width = 0.01
listening_depth = 0.006
boundary_thickness = 0.01
"""
CLOCK = """
#define _GNU_SOURCE
#include <stdio.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
int clock_gettime(clockid_t clock, struct timespec *now) {
    int result = (int)syscall(SYS_clock_gettime, clock, now), moved = 0;
    FILE *file = clock == CLOCK_REALTIME ? fopen(getenv("CLOCK_FILE"), "r") : NULL;
    if (file) {
        if (fscanf(file, "%d", &moved) == 1) now->tv_sec += moved;
        fclose(file);
    }
    return result;
}
"""
"""Before the C library: the time of day, moved by the seconds in a file."""
MB = 2**20
GROWTH = 1.1
"""Memory at the end over that after a fifth of the cells, above which something is kept that should not be."""


class Campaign:
    """A campaign in a folder."""

    def __init__(self, folder: Path, cells: int, options: tuple[str, ...], *, with_clock: bool) -> None:
        self.folder, self.options, self.clock = folder, options, folder / "clock"
        self.cells = cells - cells % len(CONTENTS)
        seeds = self.cells // len(CONTENTS)
        (folder / "c.toml").write_text(CONFIGURATION.format(seeds=seeds, contents=list(CONTENTS)))
        self.database = folder / "results" / "endurance.db"
        self.variables = os.environ | {"CALCIDEM_CACHE": str(folder / "cache"), "OMPI_MCA_btl": "^ofi"}
        self.variables |= {"OMP_NUM_THREADS": "1"}
        self.variables["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        where = "from calcidem.app.campaign.packing import _cached_name as n; from calcidem.app.config.reader import "
        where += "load_configuration as l; print(n(l('c.toml').packing_hash))"
        name = subprocess.run(
            [sys.executable, "-c", where], cwd=folder, env=self.variables, check=True, capture_output=True, text=True
        )
        (folder / "cache").mkdir()
        shutil.copy(SMALL_PACKING, folder / "cache" / name.stdout.strip())
        if with_clock:
            (folder / "clock.c").write_text(CLOCK)
            subprocess.run(["cc", "-shared", "-fPIC", "-o", "clock.so", "clock.c"], cwd=folder, check=True)  # noqa: S607
            self.variables |= {"LD_PRELOAD": str(folder / "clock.so"), "CLOCK_FILE": str(self.clock)}
            self.clock.write_text("0")

    def move_clock(self) -> None:
        """Move the clock of the run, if it has one of its own, by 25 hours: forwards, then back."""
        if self.clock.exists():
            self.clock.write_text("-90000" if self.clock.read_text() == "90000" else "90000")

    def start(self) -> subprocess.Popen[bytes]:
        """Start the run, or go on with it."""
        command = [sys.executable, "-m", "calcidem", "run", "c.toml", *self.options]
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(command, cwd=self.folder, env=self.variables, stdout=log, stderr=log)

    def stored(self) -> int:
        """Cells that are stored."""
        if not self.database.exists():
            return 0
        with closing(sqlite3.connect(f"file:{self.database}?mode=ro", uri=True)) as connection:
            try:
                return int(connection.execute("select count(*) from result").fetchone()[0])
            except sqlite3.OperationalError:
                return 0  # it is being made


def descendants(process: int) -> Iterator[int]:
    """A process and all that it has started."""
    yield process
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            children = task.read_text().split()
        except OSError:
            continue
        for child in children:
            yield from descendants(int(child))


def resources(process: int) -> tuple[float, int]:
    """Memory (MB, proportional set size) and open descriptors of a process and its descendants."""
    memory, descriptors = 0.0, 0
    for found in descendants(process):
        try:
            lines = Path(f"/proc/{found}/smaps_rollup").read_text().splitlines()
            memory += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024
            descriptors += len(os.listdir(f"/proc/{found}/fd"))  # noqa: PTH208 - as many as there are
        except OSError:
            continue
    return memory, descriptors


def size(*files: Path) -> int:
    """Bytes of files that are there."""
    return sum(file.stat().st_size for file in files if file.exists())


def watch(
    campaign: Campaign, process: subprocess.Popen[bytes], marks: list[int], start: float, due: int
) -> list[float]:
    """Print a row at each mark until the run has ended or so many cells are stored; give the memory at each."""
    memories: list[float] = []
    while process.poll() is None and (cells := campaign.stored()) < due:
        time.sleep(0.5)
        if not marks or cells < marks[0]:
            continue
        while marks and cells >= marks[0]:
            marks.pop(0)
        memory, descriptors = resources(process.pid)
        database = size(campaign.database, campaign.database.with_name(campaign.database.name + "-wal"))
        row = (cells, time.monotonic() - start, memory, descriptors, database / cells, size(campaign.folder / "log"))
        print("| {} | {:.0f} | {:.0f} | {} | {:.0f} | {} |".format(*row), flush=True)
        memories.append(memory)
        campaign.move_clock()
    return memories


@contextmanager
def disk(folder: Path, megabytes: int) -> Iterator[Path]:
    """Give a folder, on a file system of so many MB if that is not 0."""
    if megabytes:
        folder.mkdir(exist_ok=True)
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", folder], check=True)  # noqa: S607
    try:
        yield folder
    finally:
        if megabytes:
            subprocess.run(["umount", "--lazy", folder], check=True)  # noqa: S607


def endure(campaign: Campaign, rows: int, stops: int, megabytes: int) -> list[str]:
    """Run the campaign to its end; give what is not as it should be."""
    complaints, start = [], time.monotonic()
    marks = [campaign.cells * (row + 1) // rows for row in range(rows)]
    ends = [campaign.cells * (stop + 1) // (stops + 1) for stop in range(stops)]
    print("| cells | s | memory of all processes, MB | descriptors | database, bytes a cell | log, bytes |")
    print("|---:|---:|---:|---:|---:|---:|", flush=True)
    memories: list[float] = []
    for _ in range(stops + bool(megabytes) + 1):
        process, stopped = campaign.start(), bool(ends)
        memories += watch(campaign, process, marks, start, ends.pop(0) if stopped else campaign.cells + 1)
        if stopped:
            process.send_signal(signal.SIGTERM)
        code, wanted = process.wait(), 75 if stopped else 0
        if code == 1 and megabytes:
            print(f"the disk was full at {campaign.stored()} cells: exit code 1, now it is four times as large")
            subprocess.run(["mount", "-o", f"remount,size={4 * megabytes}m", campaign.folder], check=True)  # noqa: S607
            megabytes = 0
        elif code != wanted:
            complaints.append(f"exit code {code} instead of {wanted}")
        elif code == 0:
            break
    if campaign.stored() != campaign.cells:
        complaints.append(f"{campaign.stored()} cells are stored, not {campaign.cells}")
    early = memories[len(memories) // 5] if memories else 0.0
    if memories and max(memories) > GROWTH * early:
        complaints.append(f"memory grew from {early:.0f} to {max(memories):.0f} MB")
    verify = [sys.executable, "-m", "calcidem", "verify", str(campaign.database), "--cells", "16"]
    code = subprocess.run(verify, env=campaign.variables, check=False).returncode
    return complaints + ([f"verify ended with {code}"] if code else [])


def main() -> None:
    """Run, print and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=100_000)
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--rows", type=int, default=10)
    parser.add_argument("--stops", type=int, default=1)
    parser.add_argument("--disk", type=int, default=0)
    parser.add_argument("--clock", action="store_true")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--gpu", action="store_true")
    options = parser.parse_args()
    with (
        tempfile.TemporaryDirectory(prefix="calcidem-endurance-") as scratch,
        disk(options.folder or Path(scratch, "run"), options.disk) as folder,
    ):
        folder.mkdir(exist_ok=True)
        run = ("--ranks", str(options.ranks), *(["--gpu"] if options.gpu else []))
        campaign = Campaign(folder, options.cells, run, with_clock=options.clock)
        complaints = endure(campaign, options.rows, options.stops, options.disk)
    print("\n".join(complaints) or "as it should be")
    sys.exit(bool(complaints))


if __name__ == "__main__":
    main()
