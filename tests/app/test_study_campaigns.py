"""Campaigns of a study: what the database has is not computed again, and no process outlives the command."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calcidem.app.config.reader import change_configuration
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.study import point_of_study, point_velocities
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure

PROGRAM = """
import multiprocessing, time
from calcidem.app.studies.study import study_workers

if __name__ == "__main__":
    with study_workers(2) as executor:
        for waiting in [executor.submit(time.sleep, 0.1) for _ in range(4)]:
            waiting.result()
        print(*(child.pid for child in multiprocessing.active_children()), flush=True)
        time.sleep(60.0)
"""


@pytest.mark.usefixtures("cached_packing")
def test_a_point_has_the_bits_of_its_cells_and_is_computed_once(
    small_configuration: Configuration, small_packing: Packing, tmp_path: Path
) -> None:
    """Velocities are those of the cells; a second call computes only a new content; an impossible one has none."""
    database = tmp_path / "points.db"
    experiment = small_configuration.experiment(small_packing)
    expected = {
        content: [np.nan if cell.vs is None else cell.vs for cell in measure(experiment, content, [1, 2])]
        for content in (0.66, 5.0)
    }
    point = point_of_study(small_configuration, database, [0.66], [1, 2])
    both = replace(small_configuration, wave=replace(small_configuration.wave, both_sides=True))
    assert point_of_study(both, database, [0.66], [1, 2]) == point  # Vs is that of one side
    np.testing.assert_array_equal(point_velocities(point)[:, 0], expected[0.66])
    assert np.isfinite(expected[0.66]).any()

    computed: list[Any] = []

    class Noting(Executor):
        def submit(self, call: Callable[..., Any], /, *words: object, **named: object) -> Future[Any]:  # type: ignore[override]
            done: Future[Any] = Future()
            computed.append(words)
            done.set_result(call(*words, **named))
            return done

    more = point_of_study(small_configuration, database, [0.66, 5.0], [1, 2])
    found = point_velocities(more, Noting())
    assert len(computed) == 1  # a batch of the new content
    np.testing.assert_array_equal(found.T, [expected[0.66], expected[5.0]])
    np.testing.assert_array_equal(point_velocities(more, Noting()), found)
    assert len(computed) == 1
    tight = change_configuration(small_configuration, {"sand.wave_stiffness_factor": 12.0})
    found = point_velocities(point_of_study(tight, database, [60.0, 0.66], [1, 2]))
    assert np.isnan(found[:, 0]).all()
    assert np.isfinite(found[:, 1]).any()


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
