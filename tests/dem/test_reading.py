"""Signals with a known delay, as benchmarks/reading draws them, are read right or refused."""

import runpy
from pathlib import Path

import numpy as np
import pytest

BENCHMARK = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "reading" / "run.py"))


@pytest.mark.parametrize(
    ("count", "wrong", "refused"), [(50, 0.02, 0.2), pytest.param(3500, 0.01, 0.1, marks=pytest.mark.full)]
)
def test_few_signals_are_read_wrong_in_silence(count: int, wrong: float, refused: float) -> None:
    """Of the judged signals fewer than 1 % are off by a tenth, and fewer than 10 % of the readable ones are refused."""
    known, errors = BENCHMARK["read_all"](BENCHMARK["RANGES"]["judged_seed"], count)
    readable = np.array([signal.readable for signal in known])
    assert np.mean(np.abs(errors["peak"]) > 0.1) <= wrong  # NaN is no reading
    assert np.mean(np.isnan(errors["peak"][readable])) <= refused
