"""Velocities of many configurations with the same packing, contents and seeds: over cores, and kept in a file."""

import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path

import numpy as np

from calcidem.app.config.checks import check_against_packing, cross_check
from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.app.config.schema import Configuration
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure
from calcidem.sweep.processes import die_with_parent

_MeasureTrials = Callable[[Sequence[Configuration]], Iterator[Floats]]
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
) -> Iterator[_MeasureTrials]:
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


_KEYS = ("physics", "packing", "contents", "seeds")
_BEGINNING = b'{"physics": "'


class KeptTrials:
    """Velocities of trials by physics of the configuration, packing, contents and seeds.

    Parameters
    ----------
    file
        File of the trials; None keeps them only in this object.
    packing
        Packing of all trials.

    Raises
    ------
    ConfigurationError
        If the file has other contents. A truncated last line is ignored.
    """

    def __init__(self, file: Path | None, packing: Packing) -> None:
        self._file, self._packing = file, packing.content_hash
        self._known: dict[str, Floats] = {}
        if file is not None and file.exists():
            self._read(file)

    def __len__(self) -> int:
        """Number of known trials."""
        return len(self._known)

    def remembered(self, measure: _MeasureTrials, contents: Sequence[float], seeds: Sequence[int]) -> _MeasureTrials:
        """Return ``measure`` for these contents and seeds with known trials taken from memory."""

        def measured(configurations: Sequence[Configuration]) -> Iterator[Floats]:
            keys = [self._key(configuration, contents, seeds) for configuration in configurations]
            unknown = [place for place, key in enumerate(keys) if json.dumps(key) not in self._known]
            found = measure([configurations[place] for place in unknown]) if unknown else iter(())
            for place in unknown:
                self._keep(keys[place], next(found))
            yield from (self._known[json.dumps(key)] for key in keys)

        return measured

    def _key(self, configuration: Configuration, contents: Sequence[float], seeds: Sequence[int]) -> list[object]:
        return [configuration.hash, self._packing, list(map(float, contents)), list(map(int, seeds))]

    def _keep(self, key: list[object], vs: Floats) -> None:
        self._known[json.dumps(key)] = vs
        if self._file is None:
            return
        rows = [[None if np.isnan(value) else float(value) for value in row] for row in vs]
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({**dict(zip(_KEYS, key, strict=True)), "vs": rows}) + "\n")
            stream.flush()
            os.fsync(stream.fileno())

    def _read(self, file: Path) -> None:
        content = file.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        cut_off = content[len(whole) :]
        lines = whole.decode(errors="replace").splitlines()
        if not (cut_off.startswith(_BEGINNING) or _BEGINNING.startswith(cut_off)):
            lines.append("")  # a stop truncated this trial
        for number, line in enumerate(lines, 1):
            try:
                trial = json.loads(line)
                key = [trial[name] for name in _KEYS]
                vs = np.array([[np.nan if value is None else float(value) for value in row] for row in trial["vs"]])
                fits = vs.shape == (len(key[3]), len(key[2]))
            except (ValueError, KeyError, TypeError):
                fits = False
            if not fits:
                problem = f"line {number}: is not a trial of a calibration; remove the file, or give --out another name"
                raise ConfigurationError(str(file), [Problem(problem)])
            self._known[json.dumps(key)] = vs
        if cut_off:
            os.truncate(file, len(whole))
