"""Which kernels a campaign compiles before its first cell."""

import contextlib
import pickle
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path

import pytest

from calcidem.app.campaign import run
from calcidem.app.campaign.cells import CellComputation, kernel_compilations
from calcidem.app.campaign.status import ProgressDisplay, ProgressReporter
from calcidem.app.config.schema import Configuration
from calcidem.dem.engine.scene import Installation, Law
from calcidem.dem.kernels.layout import Features
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure
from calcidem.sweep.run import SweepState
from calcidem.sweep.schedule import StopLevel, StopRequest


class _EnoughSeen(Exception):  # noqa: N818 - an expected end of a measurement
    """Ends a measurement whose kernels are known."""


@pytest.mark.parametrize(("law", "installation"), [("auto", "preserve"), ("finite", "preserve"), ("auto", "zero")])
@pytest.mark.parametrize("contents", [(0.0, 0.66), (0.0,)])
def test_the_kernels_of_the_cells_are_compiled_and_no_others(
    small_configuration: Configuration,
    small_packing: Packing,
    monkeypatch: pytest.MonkeyPatch,
    law: Law,
    installation: Installation,
    contents: tuple[float, ...],
) -> None:
    """One for samples, one for check samples, and those for settling where bonds change the forces."""
    used: list[Features] = []

    def note(features: Features, steps: int, *_: object) -> int:
        used.append(features)
        return steps

    monkeypatch.setattr("calcidem.dem.engine.leapfrog.advance_steps", note)
    plan = replace(small_configuration.campaign, contents=contents)
    bonding = replace(small_configuration.bonding, installation=installation)
    wave = replace(small_configuration.wave, law=law)
    configuration = replace(small_configuration, campaign=plan, bonding=bonding, wave=wave)
    for compile_kernel in kernel_compilations(configuration, small_packing):
        compile_kernel()
    compiled = set(used)
    assert len([features for features in compiled if features.recording]) == 2
    used.clear()
    experiment = replace(configuration.experiment(small_packing), is_checked=False).with_wave(
        law="finite" if installation == "zero" or law == "finite" else "linear"
    )
    for content in contents:
        looks = count()

        def check(looks: "count[int]" = looks) -> None:
            if next(looks) == 5:
                raise _EnoughSeen

        with contextlib.suppress(_EnoughSeen):
            measure(experiment, content, [1], lanes=configuration.run.lanes, raise_if_stopped=check)
    assert set(used) < compiled
    rest = compiled - set(used)
    assert {features.lanes for features in rest} == {4}  # those of the check
    assert all(not features.linear for features in rest)


@pytest.mark.skipif(sys.platform == "win32", reason="each process for itself")
def test_two_processes_of_an_executor_compile_two_kernels_at_the_same_time(
    small_configuration: Configuration, small_packing: Packing, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Each takes a kernel that no other compiles, and has a computation once all are there."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    together = threading.Barrier(2, timeout=30.0)
    compiled: list[int] = []

    def compilations(*_: object) -> list[object]:
        def compile_kernel(number: int) -> None:
            compiled.append(number)
            if len(compiled) <= 2:
                together.wait()

        return [lambda number=number: compile_kernel(number) for number in range(2)]

    monkeypatch.setattr("calcidem.app.campaign.cells.kernel_compilations", compilations)
    told = pickle.dumps(CellComputation(small_configuration, small_packing))
    with ThreadPoolExecutor(2) as pool:
        assert len(list(pool.map(pickle.loads, [told] * 2))) == 2
    assert set(compiled[:2]) == {0, 1}


def test_a_stop_during_a_compilation_begins_no_other(
    small_configuration: Configuration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One cannot be interrupted; after it the run ends without a cell."""
    stop, compiled = StopRequest(), list[int]()

    def compilations(*_: object) -> list[Callable[[], None]]:
        def compile_one(number: int) -> None:
            compiled.append(number)
            stop.level, stop.reason = StopLevel.HURRY, "SIGINT"  # as its handler does

        return [partial(compile_one, number) for number in (1, 2)]

    monkeypatch.setattr(run, "kernel_compilations", compilations)
    options = replace(small_configuration.run, database=str(tmp_path / "c.db"))
    with run.CampaignRun(replace(small_configuration, run=options)) as work:
        end = work.compute(None, ProgressReporter(ProgressDisplay()), stop)
        assert (compiled, end.state, end.tally.total()) == ([1], SweepState.STOPPED, 0)
