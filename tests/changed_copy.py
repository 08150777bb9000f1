"""Runs tests against a copy of the package in which a module is another one."""

import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from places import CHECKOUT


def run_with_copy(
    folder: Path, module: str, change: Callable[[str], str], judges: Sequence[str]
) -> subprocess.CompletedProcess[str]:
    """Run files of tests, relative to the checkout, with the package in a folder and a changed module in it."""
    shutil.copytree(CHECKOUT / "calcidem", folder / "calcidem")
    path = folder / "calcidem" / module
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    options = ["-x", "-q", "--no-header", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
    files = [str(CHECKOUT / judge) for judge in judges]
    command = [sys.executable, "-m", "pytest", *options, "--rootdir", str(CHECKOUT), *files]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # its folder comes first
