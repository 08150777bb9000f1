"""From a measurement to what the store keeps of it."""

from dataclasses import replace
from typing import Any

import pytest

from calcidem.app.campaign.cells import CellComputation, cell_result
from calcidem.app.config.schema import Configuration, RunOptions
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
