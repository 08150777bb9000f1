"""What the scheduler itself costs. The rates are printed, since a shared machine allows no sharper limits."""

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
    """While its workers compute, the master uses less than 3 % of a core."""
    measured = measure(campaign, batches=4, seconds=2.0, ranks=3)
    share = measured["cpu"] / measured["wall"]
    with capsys.disabled():
        print(f"\nidle master: {share:.2%} of a core over {measured['wall']:.1f} s")  # noqa: T201 - see above
    assert share < 0.03


@pytest.mark.parametrize("ranks", [2, 4])
def test_the_dispatch_rate_is_far_above_the_need(
    campaign: "Campaign", ranks: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Even one worker on a busy machine gets more than 200 empty batches a second; real ones take seconds."""
    measured = measure(campaign, batches=3000, seconds=0.0, ranks=ranks)
    rate = measured["cells"] / measured["wall"]
    with capsys.disabled():
        print(  # noqa: T201 - see above
            f"\n{ranks} ranks: {rate:.0f} empty batches a second,"
            f" {1e6 * measured['cpu'] / measured['cells']:.0f} us of the master's CPU time for each"
        )
    assert rate > 200
