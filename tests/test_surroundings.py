"""What a test can see of the machine that it runs on."""

import os
import pwd
import subprocess
import sys
from pathlib import Path

import pytest
from places import CHECKOUT

SEEN = """
import os
from pathlib import Path
print(sorted(os.listdir(".")), sorted(os.listdir(Path.home())))
print(Path.cwd().resolve(), Path.home().resolve())
print(sorted(name for name in os.environ if name.startswith(("CALCIDEM_", "PG", "XDG_"))))
"""


@pytest.mark.parametrize("time", ["first", "second"])
def test_a_test_begins_in_empty_folders_of_its_own(time: str, tmp_path: Path) -> None:
    """A test and what it starts see no results or variables of the caller, nor what another test left."""
    command = [sys.executable, "-c", SEEN]
    listed, places, variables = subprocess.run(
        command, check=True, capture_output=True, text=True, cwd=Path.cwd()
    ).stdout.splitlines()
    assert listed == "[] []", time
    assert variables == "[]"
    work, home = (Path(place) for place in places.split())
    assert not work.is_relative_to(CHECKOUT)
    assert home not in {Path(pwd.getpwuid(os.geteuid()).pw_dir), tmp_path}
    Path("results").mkdir()
    (home / ".pgpass").touch()
