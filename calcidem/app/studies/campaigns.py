"""Campaigns of a study: each point is a campaign of one database, so that the same command continues after a stop."""

import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from calcidem.app.campaign.run import run
from calcidem.app.config.errors import ConfigurationError
from calcidem.app.config.schema import Configuration
from calcidem.dem.kernels.layout import Floats
from calcidem.sweep.ranks import die_with_parent


@contextmanager
def study_workers(cores: int) -> Iterator[Executor | None]:
    """Processes for the campaigns of a study, until the block ends; None for a single core."""
    if cores == 1:
        yield None
        return
    # Fresh processes: a fork would share open resources of libraries. They would outlive a command that is killed.
    ending = partial(die_with_parent, os.getpid()) if sys.platform == "linux" else None
    with ProcessPoolExecutor(cores, multiprocessing.get_context("spawn"), ending) as pool:
        yield pool


def point_of_study(
    configuration: Configuration, database: Path, contents: Sequence[float], seeds: Sequence[int]
) -> Configuration:
    """The same physics as a campaign of the study's database, named by its hash; `ValueError` for impossible cells."""
    name = f"point {configuration.hash[:16]}"
    campaign = replace(configuration.campaign, name=name, contents=tuple(contents), seeds=tuple(seeds), until=None)
    run_options = replace(
        configuration.run, database=str(database), output=str(database.parent), store_sections=False, part=None
    )
    return replace(configuration, campaign=campaign, run=run_options)


def point_velocities(point: Configuration, executor: Executor | None = None) -> Floats:
    """Vs of the planned cells, m/s, (seeds, contents), NaN if missing; cells that the database has are not computed.

    A content that the configuration makes impossible has no velocity: other values of the study may allow it.
    """
    plan = point.campaign
    try:
        with run(point, progress=False, executor=executor) as campaign:
            vs = campaign.vs().reindex(seed=list(plan.seed_numbers), content=list(plan.contents))
            return np.asarray(vs.transpose("seed", "content"), dtype=float)
    except ConfigurationError:
        if len(plan.contents) == 1:
            return np.full((len(plan.seed_numbers), 1), np.nan)
    single = (replace(point, campaign=replace(plan, contents=(content,))) for content in plan.contents)
    return np.hstack([point_velocities(one, executor) for one in single])
