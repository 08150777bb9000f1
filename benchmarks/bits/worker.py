"""Measures steps of whatever checkout is on its path: a line ``regime lanes content chunks`` in, CPU seconds of a step out."""

import sys
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from calcidem.app.campaign.packing import packing_from_bytes
from calcidem.app.config import presets
from calcidem.app.config.reader import load_configuration
from calcidem.dem.wave.propagation import prepare_recorder
from calcidem.dem.wave.recorder import Recorder

PACKING = packing_from_bytes(Path(sys.argv[1]).read_bytes())
EXPERIMENT = load_configuration(Path(presets.__file__).parent / "paper-small-pulse.toml").experiment(PACKING)


def recorder_of(regime: str, lanes: int, content: float) -> tuple[Recorder, Any]:
    """A recorder whose kernel is compiled, and the state it starts from."""
    experiment = replace(EXPERIMENT, wave=replace(EXPERIMENT.wave, regime=regime))
    bonded = [experiment.ordering(seed).at(content).bonded for seed in range(1, lanes + 1)]
    recorder = prepare_recorder(experiment, bonded, experiment.frequency(content), lanes, lambda: None)
    begin = recorder.state
    recorder.record_chunk()
    return recorder, begin


def main() -> None:
    """Answer line by line."""
    known: dict[str, tuple[Recorder, Any]] = {}
    for line in sys.stdin:
        regime, lanes, content, chunks = line.split()
        case = f"{regime} {lanes} {content}"
        if case not in known:
            known[case] = recorder_of(regime, int(lanes), float(content))
        recorder, begin = known[case]
        # The module of states has another name in older checkouts.
        recorder.state = import_module(type(begin).__module__).duplicate(begin)
        before = time.process_time()
        for _ in range(int(chunks)):
            recorder.record_chunk()
        print((time.process_time() - before) / (recorder.steps_per_look * int(chunks)), flush=True)


if __name__ == "__main__":
    main()
