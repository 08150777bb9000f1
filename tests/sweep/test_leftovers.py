"""What killed launches leave on a host goes at the next start, and nothing that anybody may still use."""

import mmap
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from calcidem.launch import leftovers

LONG_AGO = 1e9


def age(path: Path) -> Path:
    """Let a file or folder be old."""
    os.utime(path, (LONG_AGO, LONG_AGO))
    return path


def session(folder: Path, process: int, host: str) -> Path:
    """Make a folder as mpirun has one."""
    made = folder / f"ompi.{process}"
    made.mkdir()
    (made / f"pmix.{host}.tool.{process}").write_text("")
    return age(made)


def test_only_what_nobody_uses_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders of dead launchers of this host, and segments that no process has mapped, unless they are new."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(leftovers, "_SHARED_MEMORY", tmp_path)
    host, user = socket.gethostname(), os.getuid()
    ended, another = (subprocess.Popen([sys.executable, "-S", "-c", ""]) for _ in range(2))
    for process in (ended, another):
        process.wait()
    gone = [session(tmp_path, ended.pid, host)]
    kept = [session(tmp_path, os.getpid(), host), session(tmp_path, another.pid, "elsewhere")]
    for name in ("dead", "mapped", "new"):
        segment = tmp_path / f"sm_segment.{host}.{user}.{name}.0"
        segment.write_bytes(bytes(4096))
        (gone if name == "dead" else kept).append(segment if name == "new" else age(segment))
    with kept[2].open("r+b") as file, mmap.mmap(file.fileno(), 0):
        leftovers.remove_leftovers()
    assert not any(path.exists() for path in gone)
    assert all(path.exists() for path in kept)
