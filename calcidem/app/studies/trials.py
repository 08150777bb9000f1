"""Velocities of many configurations with the same packing, contents and seeds, distributed over cores."""

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache, partial
from itertools import product

import numpy as np

from calcidem.app.config.checks import check_against_packing, cross_check
from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.app.config.schema import Configuration
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure
from calcidem.launch.starter import die_with_parent

MeasureTrials = Callable[[Sequence[Configuration]], Iterator[Floats]]
"""Function of configurations that yields Vs of each in turn, m/s, shape (seeds, contents), NaN if missing."""


def check_cells(
    configuration: Configuration, packing: Packing, contents: Sequence[float], seeds: Sequence[int]
) -> None:
    """Refuse contents and seeds that are impossible for the configuration or its packing.

    `ConfigurationError` lists all problems.
    """
    try:
        plan = replace(configuration.campaign, contents=tuple(contents), seeds=tuple(seeds))
    except ValueError as error:
        raise ConfigurationError("cells", [Problem(str(error))]) from error
    planned = replace(configuration, campaign=plan)
    if problems := cross_check(planned):
        raise ConfigurationError("cells", problems)
    check_against_packing(planned, packing)


@contextmanager
def trial_workers(
    packing: Packing, contents: Sequence[float], seeds: Sequence[int], cores: int = 1
) -> Iterator[MeasureTrials]:
    """Yield a function that measures configurations on ``cores`` processes until the block ends."""

    def measure_trials(
        configurations: Sequence[Configuration], spread: Callable[..., Iterator[Floats]] = map
    ) -> Iterator[Floats]:
        for_all = [_seed_batches(seeds, configuration.run.lanes) for configuration in configurations]
        jobs = [job for tried, chunks in zip(configurations, for_all, strict=True) for job in product([tried], chunks)]
        found = spread(partial(_velocities, packing, tuple(contents)), *zip(*jobs, strict=True))
        for chunks in for_all:
            yield np.concatenate([next(found) for _ in chunks])

    if cores == 1:
        yield measure_trials
        return
    # Fresh processes: a fork would share open resources of libraries. They would outlive a command that is killed.
    ending = partial(die_with_parent, os.getpid()) if sys.platform == "linux" else None
    with ProcessPoolExecutor(cores, multiprocessing.get_context("spawn"), ending) as pool:
        yield partial(measure_trials, spread=pool.map)


def _seed_batches(seeds: Sequence[int], lanes: int) -> list[tuple[int, ...]]:
    """Seeds in batches of kernel width."""
    return [tuple(seeds[begin : begin + lanes]) for begin in range(0, len(seeds), lanes)]


def _velocities(
    packing: Packing, contents: Sequence[float], configuration: Configuration, seeds: Sequence[int]
) -> Floats:
    """Vs of one batch of seeds at each content, m/s, shape (seeds, contents)."""
    experiment = configuration.experiment(packing)
    ordering = lru_cache(experiment.ordering)

    def column(content: float) -> list[float]:
        try:
            cells = measure(experiment, content, seeds, lanes=configuration.run.lanes, ordering=ordering)
        except ValueError:  # other values of the plan may allow it: more cement, a pulse that the steps resolve
            return [np.nan] * len(seeds)
        return [np.nan if cell.vs is None else cell.vs for cell in cells]

    return np.array([column(content) for content in contents]).T
