"""A whole cell of a campaign gives in YADE the signal and the velocity that it gives here."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks" / "peers"))

from cells import Ingredients, preset_experiment
from programs import HOW_TO, find_yade
from whole_cells import CASES, PRESET, compare

CONTENT, SEED = 7.0, 1


@pytest.mark.full
@pytest.mark.parametrize(
    ("laws", "finer", "signal"),
    # YADE takes the sign of the velocity half a step later, an error of first order; the rest agrees to rounding.
    [(CASES[0][1], 2, 5e-3), (Ingredients("linear", damping=False), 1, 1e-4)],
    ids=["as the preset", "without damping"],
)
def test_a_whole_cell_in_yade_has_the_same_signal_and_velocity(laws: Ingredients, finer: int, signal: float) -> None:
    """Signals differ by the order of the step with damping, by rounding without; velocities within the stated error."""
    yade = find_yade()
    if yade is None:
        pytest.skip(HOW_TO["yade"])
    row, _, _ = compare(preset_experiment(PRESET), CONTENT, SEED, ("", laws, finer), yade)
    assert row.signal < signal
    assert row.departure is not None
    assert abs(row.departure) < min(row.stated, signal)
