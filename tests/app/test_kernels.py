"""Which kernels a campaign compiles before its first cell."""

import contextlib
from dataclasses import replace
from itertools import count

import pytest

from calcidem.app.campaign.task import EnoughSeenError, kernel_compilations
from calcidem.app.config.schema import Configuration
from calcidem.dem.engine.scene import Installation, Regime
from calcidem.dem.kernels.features import Features
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.measurement import measure


@pytest.mark.parametrize(
    ("regime", "installation"), [("linear", "preserve"), ("finite", "preserve"), ("small", "zero")]
)
@pytest.mark.parametrize("contents", [(0.0, 0.66), (0.66, 5.0), (0.0,)])
def test_the_kernels_of_the_cells_are_compiled_and_no_others(
    small_configuration: Configuration,
    small_packing: Packing,
    monkeypatch: pytest.MonkeyPatch,
    regime: Regime,
    installation: Installation,
    contents: tuple[float, ...],
) -> None:
    """One for samples with cement and one for samples without, and one for settling where bonds change the forces."""
    used: list[Features] = []

    def note(features: Features, steps: int, *_: object) -> int:
        used.append(features)
        return steps

    monkeypatch.setattr("calcidem.dem.engine.leapfrog.advance_steps", note)
    plan = replace(small_configuration.campaign, contents=contents)
    bonding = replace(small_configuration.bonding, installation=installation)
    wave = replace(small_configuration.wave, regime=regime)
    configuration = replace(small_configuration, campaign=plan, bonding=bonding, wave=wave)
    for compile_kernel in kernel_compilations(configuration, small_packing):
        compile_kernel()
    compiled = set(used)
    used.clear()
    for content in contents:
        looks = count()

        def check(looks: "count[int]" = looks) -> None:
            if next(looks) == 5:
                raise EnoughSeenError

        with contextlib.suppress(EnoughSeenError):
            experiment = configuration.experiment(small_packing)
            measure(experiment, content, [1], lanes=configuration.run.lanes, check=check)
    assert compiled == set(used)
    assert len([features for features in compiled if features.recording]) == len(
        {content > 0.0 for content in contents}
    )
