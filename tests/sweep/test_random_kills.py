import os
import random
import signal
import time
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Campaign

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("kills", [2, pytest.param(100, marks=pytest.mark.full)])
def test_random_kills_lose_nothing_acknowledged(
    campaign: "Campaign", capsys: pytest.CaptureFixture[str], kills: int
) -> None:
    """After each of the kills of a random rank or of mpirun, all cells told of as stored are in the database."""
    random_numbers = random.Random(2026)
    acknowledged: set[tuple[int, float]] = set()
    for _ in range(kills):
        launch = campaign.start("--seeds", "20000", "--seconds", "0.02", "--blob", "5000", ranks=4)
        launch.wait_for_line("stored")
        time.sleep(random_numbers.uniform(0.0, 0.3))
        os.kill(random_numbers.choice(campaign.processes()), signal.SIGKILL)
        acknowledged |= launch.wait().stored()
        assert launch.exit_code != 0
        assert campaign.leaves_no_process()
        assert acknowledged <= campaign.values().keys()
    with capsys.disabled():
        print(  # noqa: T201 - the counts are what one wants to see
            f"\n{kills} kills: {len(acknowledged)} acknowledged cells, none lost; {len(campaign.values())} stored"
        )
