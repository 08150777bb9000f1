"""Processes that measure the trials of a calibration or a study."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PROGRAM = """
import multiprocessing, time
from types import SimpleNamespace
from calcidem.app.studies.trials import trial_workers

if __name__ == "__main__":
    with trial_workers(None, (1.0,), (1, 2), cores=2) as measure:
        try:
            next(measure([SimpleNamespace(run=SimpleNamespace(lanes=1))]))
        except AttributeError:  # it is no configuration, but both processes have started
            print(*(child.pid for child in multiprocessing.active_children()), flush=True)
        time.sleep(60.0)
"""


def is_running(process: int) -> bool:
    """Whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel of Linux ends them")
def test_no_process_outlives_a_command_that_is_killed(tmp_path: Path) -> None:
    """Also by SIGKILL, which leaves the command no time to end them."""
    (tmp_path / "program.py").write_text(PROGRAM)
    command = subprocess.Popen([sys.executable, tmp_path / "program.py"], stdout=subprocess.PIPE, text=True)
    assert command.stdout is not None
    workers = [int(word) for word in command.stdout.readline().split()]
    assert len(workers) == 2
    assert all(is_running(worker) for worker in workers)
    command.send_signal(signal.SIGKILL)
    command.wait()
    deadline = time.monotonic() + 30.0
    while any(is_running(worker) for worker in workers) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(is_running(worker) for worker in workers)
