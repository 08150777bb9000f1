from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Campaign, Values

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("ulfm", [True, False], ids=["ulfm", "plain"])
@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.full), 4])
def test_results_do_not_depend_on_the_number_of_ranks(
    campaign: "Campaign", expected: "Values", ranks: int, ulfm: bool
) -> None:
    """1, 2 and 4 ranks give the same values, exit code 0 and no process left."""
    launch = campaign.run("--seconds", "0.02", ranks=ranks, ulfm=ulfm)
    assert (launch.exit_code, launch.noted_exit_code) == (0, 0), launch.errors
    assert campaign.values() == expected
    assert launch.stored() == expected.keys()
    assert campaign.leaves_no_process()


@pytest.mark.parametrize("ulfm", [True, pytest.param(False, marks=pytest.mark.full)], ids=["ulfm", "plain"])
def test_all_workers_take_part(campaign: "Campaign", ulfm: bool) -> None:
    """Batches that take a while are spread over all workers and none is computed by the master."""
    campaign.run("--seconds", "0.1", ranks=4, ulfm=ulfm)
    assert campaign.rows("select distinct rank from cell order by rank") == [(1,), (2,), (3,)]


@pytest.mark.parametrize("ulfm", [True, pytest.param(False, marks=pytest.mark.full)], ids=["ulfm", "plain"])
def test_a_complete_sweep_ends_at_once(campaign: "Campaign", expected: "Values", ulfm: bool) -> None:
    """With nothing left to compute the program ends with 0, again and again, and stores nothing twice."""
    campaign.run(ulfm=ulfm)
    for _ in range(2):
        launch = campaign.run(ulfm=ulfm)
        assert (launch.exit_code, launch.stored()) == (0, set())
    assert campaign.values() == expected


def test_large_results_arrive_whole(campaign: "Campaign", expected: "Values") -> None:
    """Results of 1 MB each, far beyond what MPI sends eagerly, arrive as they were sent."""
    launch = campaign.run("--blob", "1000000", "--seeds", "4", ranks=3)
    assert launch.exit_code == 0, launch.errors
    values = campaign.values()
    assert values == {cell: value + "x" * 1_000_000 for cell, value in expected.items() if cell[0] < 4}
