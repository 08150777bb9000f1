import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "benchmarks" / "verification"
sys.path.append(str(FOLDER))

from table import Check, all_checks  # noqa: E402 - the folder has to be on the path first

ROWS = all_checks(cross_code=False)


@pytest.mark.slow
@pytest.mark.parametrize("row", [row for row in ROWS if row.quick], ids=lambda row: row.name)
def test_a_row_of_the_verification_holds(row: Check) -> None:
    """The error that the quick rows of docs/verification.md measure is within the tolerance."""
    assert row.measure() <= row.tolerance


def test_no_row_of_the_verification_is_listed_twice() -> None:
    """Each row has its own name, and none would break the table."""
    names = [row.name for row in ROWS]
    assert len(set(names)) == len(names)
    assert not [row for row in ROWS if "|" in row.name + row.source + row.reason]


def test_no_row_of_the_page_is_left_out() -> None:
    """The rows of docs/verification.md are those of the modules: none was taken for another one of the same name."""
    page = (ROOT / "docs" / "verification.md").read_text(encoding="utf-8").split("<!-- end -->")[0]
    own = [name for name in re.findall(r"(?m)^\| ([^*|]+) \|", page) if not name.startswith(("LAMMPS:", "YADE:"))]
    assert own[1:] == [row.name for row in sorted(ROWS, key=lambda row: own.index(row.name))]


@pytest.mark.full
def test_the_page_of_the_verification_is_that_of_the_program(tmp_path: Path) -> None:
    """All rows hold, other programs included where they are installed, and docs/verification.md has these rows."""
    page = shutil.copy(ROOT / "docs" / "verification.md", tmp_path)
    done = subprocess.run(
        [sys.executable, str(FOLDER / "run.py"), "--out", str(page)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    # What is measured differs between computers in the digits of rounding; every other word is the same.
    made, committed = (
        [re.sub(r"\| [^|]* \|$", "|", line) for line in Path(path).read_text(encoding="utf-8").splitlines()]
        for path in (page, ROOT / "docs" / "verification.md")
    )
    assert made == committed
