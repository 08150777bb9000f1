"""What the scheduler itself costs, in CPU time, which a busy machine changes least."""

import json
from statistics import median
from typing import TYPE_CHECKING, Any

import pytest

from calcidem.sweep.backoff import Backoff

if TYPE_CHECKING:
    from conftest import Campaign

pytestmark = [pytest.mark.mpi, pytest.mark.full]

_SHORT_SLEEPS = 100
"""At most, before the sleeps are `Backoff.LONGEST`: seven after each message of four batches, and at the end."""


def measure(campaign: "Campaign", batches: int, seconds: float, ranks: int) -> dict[str, Any]:
    """Return for so many batches wall and CPU seconds of the master, and CPU seconds of its loop between two sleeps."""
    options = ("--batches", str(batches), "--seconds", str(seconds))
    launch = campaign.start(*options, ranks=ranks, program="measure_program.py").wait()
    assert launch.exit_code == 0, launch.errors
    measured: dict[str, Any] = json.loads(launch.output)
    assert measured["cells"] == batches
    return measured


def test_an_idle_master_sleeps(campaign: "Campaign", capsys: pytest.CaptureFixture[str]) -> None:
    """While its workers compute, the master turns as seldom as its longest sleep has it, and does little in a turn."""
    measured = measure(campaign, batches=4, seconds=2.0, ranks=3)
    share, turns = measured["cpu"] / measured["wall"], measured["turns"]
    ratio = median(turns) / median(measured["bare"])
    with capsys.disabled():
        print(  # noqa: T201 - see above
            f"\nidle master: {share:.2%} of a core over {measured['wall']:.1f} s, {len(turns)} turns of"
            f" {1e6 * median(turns):.0f} us, {ratio:.1f} times a bare look for messages"
        )
    assert len(turns) < measured["wall"] / Backoff.LONGEST + _SHORT_SLEEPS
    assert ratio < 4.0
    # With others on the machine, what they push out of the caches has to be fetched again in each turn.
    assert share < 0.1


@pytest.mark.parametrize("ranks", [2, 4])
def test_the_dispatch_rate_is_far_above_the_need(
    campaign: "Campaign", ranks: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """An empty batch costs the master less than 2 ms of CPU time; real ones take a worker seconds."""
    measured = measure(campaign, batches=3000, seconds=0.0, ranks=ranks)
    cost = measured["cpu"] / measured["cells"]
    with capsys.disabled():
        print(f"\n{ranks} ranks: {1e6 * cost:.0f} us of the master's CPU time for an empty batch")  # noqa: T201 - see above
    assert cost < 2e-3
