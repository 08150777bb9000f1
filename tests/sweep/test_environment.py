import os

import pytest

from calcidem.sweep.ranks import (
    available_cores,
    launcher,
    own_rank,
    refuse_ranks_off_linux,
    refuse_singletons,
    whole_number,
)
from calcidem.sweep.schedule import LaunchError


@pytest.mark.parametrize("variables", [{"SLURM_NTASKS": "8"}, {"SLURM_NTASKS": "8", "SLURM_STEP_NUM_TASKS": "8"}])
def test_several_slurm_tasks_without_mpirun_are_refused(variables: dict[str, str]) -> None:
    """`srun python` gives independent programs: refused with the cure."""
    with pytest.raises(LaunchError, match=r"TASKS is 8.*mpirun"):
        refuse_singletons(variables)


@pytest.mark.parametrize(
    "variables",
    [
        {},
        {"SLURM_NTASKS": "1"},
        {"SLURM_NTASKS": "3", "SLURM_STEP_NUM_TASKS": "1"},  # the shell that salloc opens
        {"SLURM_NTASKS": "8", "OMPI_COMM_WORLD_SIZE": "1"},
    ],
)
def test_other_launches_are_accepted(variables: dict[str, str]) -> None:
    """One task, and ranks that know about each other, are fine."""
    refuse_singletons(variables)


@pytest.mark.parametrize("text", ["abc", "0", "-1", "1.5", "1000000000000", "9" * 5000, "\N{SUPERSCRIPT TWO}"])
def test_a_number_of_tasks_that_is_none_is_refused(text: str) -> None:
    """The error names variable, value and remedy, and nothing of that size is ever begun."""
    with pytest.raises(LaunchError, match=r"SLURM_NTASKS=.*set it to a whole number from 1 to 100000, or unset it"):
        whole_number("SLURM_NTASKS", {"SLURM_NTASKS": text})


def test_tasks_are_counted() -> None:
    """The number of tasks of a job is taken as it is; outside of one there is none."""
    assert whole_number("SLURM_NTASKS", {"SLURM_NTASKS": " 12 "}) == 12
    assert whole_number("SLURM_NTASKS", {"SLURM_NTASKS": ""}) is None
    assert whole_number("SLURM_NTASKS", {}) is None


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
    """Variables of a launcher say that MPI is to be loaded, and the number of this rank; without them it is not."""
    assert launcher({"OMPI_COMM_WORLD_SIZE": "4", "PMIX_RANK": "0"}) == "Open MPI mpirun"
    assert own_rank({"OMPI_COMM_WORLD_RANK": "3"}) == 3
    assert own_rank({"PMI_RANK": "2"}) == 2
    assert launcher({"SLURM_JOB_ID": "5"}) is None
    assert own_rank({"SLURM_JOB_ID": "5"}) is None


@pytest.mark.parametrize("text", ["abc", "-1", "1.5", "9" * 5000, "\N{SUPERSCRIPT TWO}"])
def test_a_rank_that_is_none_is_refused(text: str) -> None:
    """The error names variable, value and remedy."""
    with pytest.raises(LaunchError, match=r"PMI_RANK=.*set it to a whole number from 0 to 100000, or unset it"):
        own_rank({"PMI_RANK": text})
