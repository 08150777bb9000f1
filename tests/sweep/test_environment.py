import os

import pytest

from calcidem.app.campaign.ranks import _refuse_singletons
from calcidem.sweep.environment import available_cores, fault_tolerance_enabled, launcher, refuse_ranks_off_linux
from calcidem.sweep.options import SweepOptions
from calcidem.sweep.sweep_end import LaunchError


def test_several_slurm_tasks_without_mpirun_are_refused() -> None:
    """`srun python` gives independent programs: refused with the cure."""
    with pytest.raises(LaunchError, match=r"SLURM_NTASKS is 8.*use mpirun"):
        _refuse_singletons(1, {"SLURM_NTASKS": "8"})


@pytest.mark.parametrize(
    ("world_size", "variables"),
    [
        (1, {}),
        (1, {"SLURM_NTASKS": "1"}),
        (8, {"SLURM_NTASKS": "8"}),
        (1, {"SLURM_NTASKS": "8", "OMPI_COMM_WORLD_SIZE": "1"}),
    ],
)
def test_other_launches_are_accepted(world_size: int, variables: dict[str, str]) -> None:
    """One task, ranks that know about each other, and one rank on purpose are fine."""
    _refuse_singletons(world_size, variables)


def test_ranks_are_for_linux() -> None:
    """Elsewhere ranks are refused with the name of the platform and the cure; on Linux they are not."""
    refuse_ranks_off_linux("linux")
    with pytest.raises(LaunchError, match=r"this is darwin: leave out --ranks.*or use Linux"):
        refuse_ranks_off_linux("darwin")


def test_cores_are_counted_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without an affinity to ask for, all cores of the machine count."""
    monkeypatch.delattr("os.sched_getaffinity")
    assert available_cores() == os.cpu_count()


def test_the_launcher_is_recognised() -> None:
    """Variables of a launcher say that MPI is to be loaded; without them it is not."""
    assert launcher({"OMPI_COMM_WORLD_SIZE": "4", "PMIX_RANK": "0"}) == "Open MPI mpirun"
    assert launcher({"SLURM_JOB_ID": "5"}) is None


def test_fault_tolerance_is_what_mpirun_says() -> None:
    """ULFM is on exactly if mpirun was told so."""
    assert fault_tolerance_enabled({"OMPI_MCA_mpi_ft_enable": "1"})
    assert not fault_tolerance_enabled({"OMPI_MCA_mpi_ft_enable": "0"})
    assert not fault_tolerance_enabled({})


@pytest.mark.parametrize(
    ("name", "value"),
    [("time_limit", 0.0), ("hard_limit_factor", 1.0), ("watchdog_margin", -1.0), ("stop_grace", float("nan"))],
)
def test_options_refuse_impossible_values(name: str, value: float) -> None:
    """A value out of range is refused with its name."""
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        SweepOptions(**{name: value})


def test_no_time_may_be_left() -> None:
    """A margin and the times to stop may be zero."""
    options = SweepOptions(watchdog_margin=0.0, stop_grace=0.0, hurry_grace=0.0, time_limit=1e-3)
    assert options.watchdog_limit == options.hard_limit


def test_the_guards_of_a_batch_are_nested() -> None:
    """The hard limit lies behind the time limit, and the watchdog behind both; without a limit there are none."""
    options = SweepOptions(time_limit=10.0)
    assert options.time_limit is not None
    assert options.hard_limit is not None
    assert options.watchdog_limit is not None
    assert options.time_limit < options.hard_limit < options.watchdog_limit
    assert SweepOptions().hard_limit is None
    assert SweepOptions().watchdog_limit is None
