"""Trials of a calibration in a file, one line of JSON each, so that none is measured twice."""

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from calcidem.app.config.errors import ConfigurationError, Problem
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.trials import MeasureTrials
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.packing import Packing

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

    def remembered(self, measure: MeasureTrials, contents: Sequence[float], seeds: Sequence[int]) -> MeasureTrials:
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
