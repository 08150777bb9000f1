"""From a measurement to what the store keeps of it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calcidem.app.campaign.cells import CellComputation, cell_result
from calcidem.app.config.schema import Configuration, RunOptions
from calcidem.dem.sample.cement import GIVEN, Pattern
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure
from calcidem.dem.wave.static_speed import LARGEST_STATIC_ERROR, static_speed
from calcidem.storage.records import EXACT_QUANTITIES
from calcidem.sweep.schedule import Batch, Cell

pytestmark = pytest.mark.slow


def computed(configuration: Configuration, packing: Packing, seed: int, content: float) -> dict[str, Any]:
    """Compute one cell as a worker does; return the numbers that it sends."""
    batch: Batch[Cell] = Batch(((seed, content),))
    (result,) = CellComputation(configuration, packing)(batch, lambda: None)
    return result.values()


def test_a_changed_pattern_of_one_name_is_checked_anew(
    small_configuration: Configuration, small_packing: Packing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hash has the name alone; the check of a former function would give its errors, step and law."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(tmp_path))
    pattern = replace(small_configuration.pattern, drawn_by="own")
    found = []
    patterns: tuple[Pattern, ...] = (
        lambda points, _: np.argsort(points[:, 1]),
        lambda points, random: random.permutation(len(points)),
    )
    for function in (*patterns, patterns[0]):
        monkeypatch.setitem(GIVEN, "own", function)
        computation = CellComputation(replace(small_configuration, pattern=pattern), small_packing)
        found.append(computation._checked(5.0, lambda: None))
        assert len(list(tmp_path.glob("check-*.json"))) == min(len(found), 2)
    assert found[0] == found[2] != found[1]


def test_wavelengths_on_the_path_are_the_periods_of_the_travel_time(
    small_configuration: Configuration, small_packing: Packing
) -> None:
    """L / lambda is frequency times travel time; the static speed is left out unless asked for, and is then kept."""
    cell = computed(small_configuration, small_packing, 1, 0.66)
    periods = cell["frequency"] * cell["distance"] / cell["vs"]
    assert cell["wavelengths_on_path"] == pytest.approx(periods, rel=1e-14)
    assert cell["static_speed"] is None
    options = RunOptions(static_speed=True)
    asked = computed(replace(small_configuration, run=options), small_packing, 1, 0.66)
    experiment = small_configuration.experiment(small_packing)
    found = static_speed(experiment, experiment.ordering(1).at(0.66).bonded)
    assert asked["static_speed"] == (found.speed if found.error <= LARGEST_STATIC_ERROR else None)
    assert asked["vs"] == cell["vs"]


def test_exact_quantities_need_no_graph(small_configuration: Configuration, small_packing: Packing) -> None:
    """Those of a worker are those of `verify`, which has no graph of the packing."""
    sent = computed(small_configuration, small_packing, 1, 0.66)
    experiment = small_configuration.experiment(small_packing)
    (measured,) = measure(experiment, 0.66, [1], lanes=small_configuration.run.lanes)
    bare = cell_result(measured, experiment, store_sections=False).values()
    assert {name: bare[name] for name in EXACT_QUANTITIES} == {name: sent[name] for name in EXACT_QUANTITIES}
