"""What the scheduler itself costs, in CPU time, which a busy machine changes least."""

import json
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Campaign

pytestmark = [pytest.mark.mpi, pytest.mark.full]


def measure(campaign: "Campaign", batches: int, seconds: float, ranks: int) -> dict[str, float]:
    """Return wall and CPU seconds of the master for so many batches."""
    options = ("--batches", str(batches), "--seconds", str(seconds))
    launch = campaign.start(*options, ranks=ranks, program="measure_program.py").wait()
    assert launch.exit_code == 0, launch.errors
    measured: dict[str, float] = json.loads(launch.output)
    assert measured["cells"] == batches
    return measured


def test_an_idle_master_sleeps(campaign: "Campaign", capsys: pytest.CaptureFixture[str]) -> None:
    """While its workers compute, the master uses less than a tenth of a core; one that blocks uses half of it."""
    measured = measure(campaign, batches=4, seconds=2.0, ranks=3)
    share = measured["cpu"] / measured["wall"]
    with capsys.disabled():
        print(f"\nidle master: {share:.2%} of a core over {measured['wall']:.1f} s")  # noqa: T201 - see above
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
