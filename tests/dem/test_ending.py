"""Long computations ask between chunks of work whether they are to end: also while disks come to rest."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calcidem.dem.engine.scene import Sand, Scene
from calcidem.dem.engine.state import start
from calcidem.dem.sample.compaction import SettlingError, box_walls, make_packing, settle
from calcidem.dem.sample.packing import Packing, PackingRule
from calcidem.dem.wave.experiment import Experiment, WaveRule
from calcidem.dem.wave.propagation import prepare_recorder

RULE = PackingRule(width=0.02, height=0.02, unbalanced_force_ratio=1e-3)


class EndedError(Exception):
    """What a check raises."""


@dataclass
class Check:
    """Ends the work at a call."""

    at_call: int
    calls: int = 0

    def __call__(self) -> None:
        """Count, and end the work when it is time."""
        self.calls += 1
        if self.calls == self.at_call:
            raise EndedError


@pytest.fixture(scope="module")
def packing() -> Packing:
    """Some 60 disks."""
    return make_packing(RULE, Sand(), np.random.default_rng(3))


def test_a_packing_that_is_made_can_be_ended() -> None:
    """What the check raises ends the making of a packing."""
    check = Check(3)
    with pytest.raises(EndedError):
        make_packing(RULE, Sand(), np.random.default_rng(3), check)
    assert check.calls == 3


@pytest.mark.full
def test_a_sample_that_settles_can_be_ended(packing: Packing) -> None:
    """What the check raises ends the settling, which would have been given up after two chunks of steps."""
    walls = box_walls(packing.width, packing.height, RULE.stress * packing.width)
    scene = Scene(packing.x, packing.y, packing.radius, Sand(), walls, damping=RULE.damping)
    state = start(scene, preload=packing.preload)
    with pytest.raises(SettlingError):
        settle(state, unbalanced_force_ratio=1e-15, most_steps=1000)
    with pytest.raises(EndedError):
        settle(state, unbalanced_force_ratio=1e-15, most_steps=1000, raise_if_stopped=Check(2))


@pytest.mark.full
def test_a_sample_without_damping_settles_at_a_step_for_the_damping_of_settling(small_packing: Packing) -> None:
    """Which lowers the limit by a quarter; the wave keeps its own step."""
    wave = WaveRule(law="finite", damping=0.0, boundary_damping=0.0, step_fraction=0.95, most_settling_steps=20_000)
    wave = replace(wave, receiver_half_width=0.012, boundary_thickness=0.012, listening_depth=0.006)
    experiment = Experiment(small_packing, wave=wave, installation="zero", is_checked=False)
    bonded = experiment.ordering(1).at(2.0).bonded
    recorder = prepare_recorder(experiment, [bonded], 24e3, 1, lambda: None)
    assert recorder.state.time_step == 0.95 * recorder.state.critical_time_step
