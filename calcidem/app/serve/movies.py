"""Movies of waves: one process at a time computes one, unless a run needs the core."""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calcidem.app.serve.feed import CampaignFeed
from calcidem.storage.passwords import hide_passwords, keep_passwords_back
from calcidem.sweep.ranks import available_cores

_TIME_LIMIT = 600.0
"""Seconds after which a movie is given up."""

_PROGRAM = """
import os, runpy, sys
from calcidem.sweep.ranks import die_with_parent
parent = int(sys.argv.pop(1))
if sys.platform == "linux":
    die_with_parent(parent)
os.nice(19)
runpy.run_module("calcidem", run_name="__main__", alter_sys=True)
"""

Wanted = tuple[int, int, float]
"""Number of the campaign, and seed and content of a cell."""


@dataclass(slots=True)
class _Work:
    """Movie in computation."""

    wanted: Wanted
    process: "subprocess.Popen[bytes]"
    file: Path
    errors: Path
    began: float


class MovieMaker:
    """Computes movies with `calcidem show`; used only by the server's thread, the parent of the process."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._work: _Work | None = None
        self._made: dict[Wanted, Path] = {}
        self._failed: dict[Wanted, str] = {}

    def start(self, wanted: Wanted, feed: CampaignFeed, status: dict[str, Any]) -> dict[str, Any]:
        """Begin the movie of a cell unless it exists, and return its progress."""
        self._look()
        self._failed.pop(wanted, None)
        if wanted in self._made or (self._work is not None and self._work.wanted == wanted):
            return self.state(wanted)
        if refusal := self._refusal(status):
            return {"state": "refused", "reason": refusal}
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="calcidem-movies-"))
        _, seed, content = wanted
        file = self._folder / f"{len(self._made)}-{time.monotonic_ns()}.gif"
        errors = file.with_suffix(".txt")
        command = [sys.executable, "-c", _PROGRAM, str(os.getpid()), "show", feed.database]
        command += [
            f"--seed={seed}",
            f"--content={content!r}",
            f"--movie={file}",
            *([] if feed.name is None else [f"--campaign={feed.name}"]),
        ]
        with errors.open("wb") as stream:
            process = subprocess.Popen(  # noqa: S603 - our own program
                keep_passwords_back(command),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stream,
                process_group=0,
            )
        self._work = _Work(wanted, process, file, errors, time.monotonic())
        return self.state(wanted)

    def state(self, wanted: Wanted) -> dict[str, Any]:
        """Return the progress of the movie of a cell."""
        self._look()
        if wanted in self._made:
            return {"state": "done", "file": self._made[wanted].name}
        if self._work is not None and self._work.wanted == wanted:
            return {"state": "working", "seconds": round(time.monotonic() - self._work.began)}
        if wanted in self._failed:
            return {"state": "failed", "reason": self._failed[wanted]}
        return {"state": "none"}

    def file(self, name: str) -> Path | None:
        """Return the file of a movie by its name."""
        return next((file for file in self._made.values() if file.name == name), None)

    def end(self) -> None:
        """End the process and remove all movies."""
        if self._work is not None:
            self._work.process.kill()
            self._work.process.wait()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _refusal(self, status: dict[str, Any]) -> str:
        """Reason why no movie can be computed now; else empty."""
        if self._work is not None:
            return "another movie is being computed; wait for it, one at a time is"
        run, cores = status.get("run") or {"host": ""}, available_cores()
        here = run["host"] == os.uname().nodename
        if status.get("running") and here and status["workers"] >= cores:
            return f"the run has all {cores} cores; a movie would slow it down. Try again when the run has ended"
        return ""

    def _look(self) -> None:
        """Record the end of the process, and end it after too long a time."""
        work = self._work
        if work is None:
            return
        late = time.monotonic() - work.began > _TIME_LIMIT
        if work.process.poll() is None and not late:
            return
        if late:
            work.process.kill()
        code = work.process.wait()
        self._work = None
        if code == 0 and work.file.exists():
            self._made[work.wanted] = work.file
            while len(self._made) > 8:
                self._made.pop(next(iter(self._made))).unlink(missing_ok=True)
            return
        said = work.errors.read_text(encoding="utf-8", errors="replace").strip().removeprefix("Error: ")
        limit = f"it took more than {_TIME_LIMIT:g} s"
        self._failed[work.wanted] = limit if late else hide_passwords(said) or f"the process ended with {code}"
