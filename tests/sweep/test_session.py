from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from calcidem.sweep import session as module
from calcidem.sweep.session import Session

if TYPE_CHECKING:
    from conftest import Campaign

ULFM = pytest.mark.parametrize("ulfm", [True, pytest.param(False, marks=pytest.mark.full)], ids=["ulfm", "plain"])


def test_a_program_alone_has_rank_0_of_1() -> None:
    """Without a launcher there is no communicator, and what is broadcast comes back."""
    with Session() as session:
        assert (session.comm, session.rank, session.size) == (None, 0, 1)
        assert session.broadcast("value") == "value"
        with pytest.raises(ValueError, match="value is None on rank 0"):
            session.broadcast(None)
        assert session.gather("value") == ["value"]
        called: list[int] = []
        session.share_on_node([lambda: called.append(1)])
        assert called == [1]


@pytest.mark.parametrize(("failed", "ended"), [({1}, False), ({1, 2}, True)])
def test_the_others_have_ended_if_all_of_them_failed(
    failed: set[int], ended: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three ranks, two are others."""
    monkeypatch.setattr(module, "wait_until", lambda condition, limit: condition())  # noqa: ARG005 - as it is called
    last: Any = SimpleNamespace(
        comm=SimpleNamespace(Iprobe=lambda _: False), _ranks=SimpleNamespace(failed=lambda: failed), rank=0, size=3
    )
    assert Session._others_have_ended(last) is ended


@pytest.mark.parametrize("code", [0, 75])
def test_a_program_alone_ends_with_its_exit_code(code: int) -> None:
    """`end` leaves by SystemExit, so that a program alone can still clean up."""
    with pytest.raises(SystemExit) as caught, Session() as session:
        session.end(code)
    assert caught.value.code == code


@pytest.mark.mpi
@ULFM
def test_a_broadcast_value_arrives_on_all_ranks(campaign: "Campaign", ulfm: bool) -> None:
    """3 MB from rank 0 arrive unchanged everywhere."""
    launch = campaign.start("broadcast", ranks=4, ulfm=ulfm, program="session_program.py").wait()
    assert launch.exit_code == 0, launch.errors


@pytest.mark.mpi
@ULFM
def test_values_of_all_ranks_arrive_on_rank_0(campaign: "Campaign", ulfm: bool) -> None:
    """Values of different sizes arrive in the order of the ranks, and on rank 0 only."""
    launch = campaign.start("gather", ranks=4, ulfm=ulfm, program="session_program.py").wait()
    assert launch.exit_code == 0, launch.errors
    assert sorted(launch.output.splitlines()) == ["[0, 100000, 200000, 300000]", "[]", "[]", "[]"]


@pytest.mark.mpi
def test_one_rank_of_a_node_acts_for_all(campaign: "Campaign") -> None:
    """An action that is needed once for each node is done once on this one."""
    launch = campaign.start("once", ranks=4, program="session_program.py").wait()
    assert launch.output == "once\n"


@pytest.mark.mpi
@ULFM
def test_an_exception_on_one_rank_ends_all(campaign: "Campaign", ulfm: bool) -> None:
    """An error of one rank while the others wait ends the program with 1, its traceback and no process left."""
    launch = campaign.start("raise", ranks=3, ulfm=ulfm, program="session_program.py").wait()
    assert launch.exit_code == 1
    assert "RuntimeError: on order" in launch.errors
    assert campaign.leaves_no_process()


@pytest.mark.full
@pytest.mark.mpi
def test_a_rank_without_memory_ends_all(campaign: "Campaign") -> None:
    """A rank that has no memory even to tell of its error keeps no other one waiting."""
    launch = campaign.start("no memory", ranks=3, program="session_program.py").wait()
    assert launch.exit_code != 0
    assert campaign.leaves_no_process()


@pytest.mark.mpi
def test_ranks_sleep_while_they_wait_for_rank_0(campaign: "Campaign") -> None:
    """Waiting 2 s for a broadcast costs less than 0.2 s of CPU time; a blocking one would cost all of it."""
    launch = campaign.start("wait", ranks=3, program="session_program.py").wait()
    assert max(float(line) for line in launch.output.splitlines()) < 0.2
