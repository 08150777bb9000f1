"""How wide a kernel some seeds need, and the processor time that measuring them takes."""

from collections.abc import Sequence
from time import process_time

from calcidem.app.studies.accuracy.settings import Setting
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import Measurement, measure, measure_all

Compiled = set[tuple[str, str, bool, int]]


def timed(
    experiment: Experiment, content: float, seeds: Sequence[int], lanes: int
) -> tuple[tuple[Measurement, ...], float]:
    """Measure, and give the processor time of a cell, s.

    Processor time leaves out what other programs take of a shared machine, unlike the wall time of a `Measurement`.
    """
    began = process_time()
    found = measure_all(experiment, content, seeds, lanes=lanes)
    return found, (process_time() - began) / len(seeds)


def fitting_lanes(seeds: Sequence[int], lanes: int) -> int:
    """Width of the kernel that so many seeds fill: the smallest power of two, at most ``lanes``."""
    return min(lanes, 1 << (len(seeds) - 1).bit_length())


def warm_up(setting: Setting, content: float, seeds: Sequence[int], lanes: int, compiled: Compiled) -> None:
    """Compile the kernel that a setting needs unless that has been done, so that no run time contains it."""
    wave = setting.experiment.wave
    kernel = (wave.regime, wave.precision, content > 0.0, lanes)
    if kernel in compiled:
        return
    compiled.add(kernel)

    class CompiledError(Exception):
        """Ends the run once the kernel has run."""

    calls = 0

    def stop() -> None:
        nonlocal calls
        calls += 1
        if calls > 1:
            raise CompiledError

    try:
        measure(setting.experiment, content, seeds[:1], lanes=lanes, check=stop)
    except CompiledError:
        return
