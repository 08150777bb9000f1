"""Small errors that the tests have to notice: of `benchmarks/mutation/run.py`, a sentinel for each kind of module."""

from pathlib import Path

import pytest
from changed_copy import run_with_copy
from places import CHECKOUT

SENTINELS = [
    ("analysis/intervals.py", "np.sqrt((n - 1) / scipy", "np.sqrt((n - 2) / scipy", "analysis/test_intervals.py"),
    (
        "analysis/measured.py",
        "standard_deviation / math.sqrt(vs",
        "standard_deviation * math.sqrt(vs",
        "analysis/test_measured.py",
    ),
    ("analysis/distribution.py", "float(own / reference)", "float(own * reference)", "analysis/test_sensitivity.py"),
    ("analysis/correlation.py", ") / np.sqrt(variance_x", ") * np.sqrt(variance_x", "analysis/test_weights.py"),
    ("analysis/fits.py", "np.array([-half, 0.0", "np.array([half, 0.0", "analysis/test_predictor.py"),
    ("analysis/intervals.py", "+ 2.0 / (1.0 - level)", "+ 3.0 / (1.0 - level)", "analysis/test_predictor.py"),
    ("dem/wave/section.py", "self.amplitude / self.frequency", "self.amplitude * self.frequency", "dem/test_pulse.py"),
    ("dem/wave/section.py", "(0.5 * cycle) ** 2", "(0.5 * cycle) ** 4", "dem/test_pulse.py"),
    ("dem/wave/check.py", "0.5 * step_fraction", "1.0 * step_fraction", "dem/test_check.py"),
    ("dem/engine/portable.py", "0.5 * (left", "0.4 * (left", "dem/test_maxima.py"),
    ("dem/engine/scene.py", "(2.0 / 3.0 * self.shear", "(1.0 / 3.0 * self.shear", "dem/test_verification.py"),
    ("dem/sample/packing.py", "LARGEST_OVERLAP = 0.1\n", "LARGEST_OVERLAP = 0.13\n", "dem/test_judgement.py"),
    ("sweep/schedule.py", "self.losses > 1", "self.losses > 2", "sweep/test_batch.py"),
    ("app/campaign/run.py", "losses >= LOSSES_BEFORE_Q", "losses > LOSSES_BEFORE_Q", "app/test_until.py"),
    ("sweep/schedule.py", "in reversed(batch.cells", "in iter(batch.cells", "sweep/test_schedule.py"),
    ("app/campaign/status.py", "seconds_left * status", "seconds_left / status", "app/test_progress.py"),
    ("wording.py", "divmod(minutes, 60)", "divmod(minutes, 61)", "sweep/test_progress.py"),
]
"""Module, its text and what stands there instead, and the tests that know it."""

NUMBERS = {
    ("reading", "reading"): (
        ("SILENCE = 0.001\n", "SILENCE = 0.0013\n"),
        ("_ONSET = 0.1\n", "_ONSET = 0.13\n"),
        ("smoothing: PositivePart = 0.3 ", "smoothing: PositivePart = 0.39 "),
        ("largest_error: PositivePart = 0.5", "largest_error: PositivePart = 0.65"),
        ("+ 1.35 / frequency", "+ 1.75 / frequency"),
        ("< 0.5 * period", "< 0.65 * period"),
    ),
    ("section", "reading"): (
        ("P_OVER_S = 1.4\n", "P_OVER_S = 1.8\n"),
        ("_SPACING = 8\n", "_SPACING = 6\n"),
        ("_TERMS = 24\n", "_TERMS = 16\n"),
        ("1.15 * clamp", "1.5 * clamp"),
        (">= 0.5 * places", ">= 0.65 * places"),
    ),
    ("section", "section"): (
        ("RESOLUTION = 2.0**-20", "RESOLUTION = 2.0**-19"),
        ("< 2**30, steps, 2**30", "< 2**29, steps, 2**29"),
    ),
    ("experiment", "section"): (("min(9, max", "min(12, max"),),
}
"""Numbers of the reading, the fit, the section and the stations, each moved by about 30 %."""
SENTINELS += [
    (f"dem/wave/{name}.py", *change, f"dem/test_{judge}.py")
    for (name, judge), changes in NUMBERS.items()
    for change in changes
]


def test_each_text_is_there_once() -> None:
    """Otherwise a sentinel would sleep until the next full run."""
    for module, text, _, judge in SENTINELS:
        assert (CHECKOUT / "calcidem" / module).read_text(encoding="utf-8").count(text) == 1, (module, text)
        assert (CHECKOUT / "tests" / judge).is_file(), judge


@pytest.mark.full
@pytest.mark.parametrize(("module", "text", "instead", "judge"), SENTINELS)
def test_a_small_error_is_noticed(tmp_path: Path, module: str, text: str, instead: str, judge: str) -> None:
    """A test fails, and it is a test, not an import."""

    def change(source: str) -> str:
        assert source.count(text) == 1, source.count(text)
        return source.replace(text, instead)

    done = run_with_copy(tmp_path, module, change, [f"tests/{judge}"])
    assert done.returncode == 1, done.stdout
    assert "FAILED" in done.stdout
    assert "error" not in done.stdout.splitlines()[-1]
